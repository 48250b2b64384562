"""Collective Perception Messages: bytes by ETSI's own modules, through another implementation, and back."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from tests.io.export.test_export import street
from tests.io.export.test_opened import HAMBURG

from viewshed.detections import Detections, ObjectKind
from viewshed.io.export import claimed_by_cpm, to_cpm
from viewshed.io.export.cpm import to_cpm_uper
from viewshed.io.messages.cpm import CONTAINERS, MAX_BYTES, MESSAGE, Station, decode_cpm, encode_cpm
from viewshed.io.messages.uper import Boolean, Choice, Integer, OpenType, Record, SequenceOf, Type, decode, encode

STATION = Station(4711, 40.4406, -79.9959, 230.5, 0.3)
T_NS = 1_167_609_600_000_000_000  # 2007-01-01, of which the dictionary says: 94,694,401,000 ms


@pytest.fixture(scope="module")
def modules(real_data: Path) -> Any:
    """ETSI's modules, compiled by asn1tools."""
    folder = real_data.parent / "judges" / "cpm"
    if not folder.is_dir():
        pytest.skip("no ASN.1 of ETSI: ../shared/judges is not there")
    asn1tools = pytest.importorskip("asn1tools")
    texts = [file.read_text(encoding="latin-1") for file in sorted(folder.rglob("*.asn"))]
    text = "\n".join(texts)
    # X.691 packs by the outermost of a type's constraints, as asn1c does: three to sixteen points, 0 to 14. asn1tools
    # takes the innermost of both, so that they are put plainly.
    text, points = re.subn(r"polygon\s+SequenceOfCartesianPosition3d \(SIZE\(3\.\.16,\.\.\.\)\)",
                           "polygon SEQUENCE (SIZE(3..16,...)) OF CartesianPosition3d", text)  # fmt: skip
    text, kinds = re.subn(r"\(unknown\s*\|\s*passengerCar\.\.tram\s*\|\s*agricultural\)", "(0..14)", text)
    assert (points, kinds) == (1, 1)
    return asn1tools.compile_string(text, "uper")


NAMES = {4: "PerceptionRegionContainer", 5: "PerceivedObjectContainer", 1: "OriginatingVehicleContainer"}
"""Number of a container → name of its type."""


def values_of(kind: Type) -> st.SearchStrategy[Any]:
    """Values of a type, as JSON has them."""
    match kind:
        case Integer(low, high):
            return st.integers(low, high)
        case Boolean():
            return st.booleans()
        case Record(members):
            known = {name: values_of(of) for name, of in members.items() if name != "trailerDataSet?"}
            optional = {name.rstrip("?"): of for name, of in known.items() if name.endswith("?")}
            needed = {name: of for name, of in known.items() if not name.endswith("?")}
            return st.fixed_dictionaries(needed, optional=optional)
        case SequenceOf(of, min_size, max_size):
            return st.lists(values_of(of), min_size=min_size, max_size=min(max_size, min_size + 2))
        case Choice(alternatives):
            return st.one_of([st.fixed_dictionaries({name: values_of(of)}) for name, of in alternatives.items()])
        case OpenType():
            return st.one_of([st.fixed_dictionaries({name: values_of(of)}) for name, of in kind.of.values()])


def as_asn1tools(value: Any) -> Any:
    """A value as asn1tools has it: a choice is a pair, an enumeration a name, bits bytes and their number."""
    if isinstance(value, list):
        return [as_asn1tools(each) for each in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {"bits"}:
        return ((value["bits"] << 3).to_bytes(2, "big"), 13)
    if len(value) == 1 and next(iter(value)) in CHOICES:
        [(name, inner)] = value.items()
        return (name, as_asn1tools(inner))
    made = {name: as_asn1tools(inner) for name, inner in value.items()}
    if "clusterProfiles" in made:
        made["clusterProfiles"] = (bytes([value["clusterProfiles"] << 4]), 4)
    if "zAngularVelocity" in made:
        made["zAngularVelocity"] = made["zAngularVelocity"] | {
            "confidence": ANGULAR[value["zAngularVelocity"]["confidence"]]
        }
    return made


CHOICES = {
    "rectangular", "circular", "polygonal", "elliptical", "radial", "radialShapes", "polarVelocity",
    "cartesianVelocity",
    "polarAcceleration", "cartesianAcceleration", "vehicleSubClass", "vruSubClass", "groupSubClass", "otherSubClass",
    "pedestrian", "bicyclistAndLightVruVehicle", "motorcyclist", "animal", "roadsegment", "intersection",
}  # fmt: skip
ANGULAR = ("degSec-01", "degSec-02", "degSec-05", "degSec-10", "degSec-20", "degSec-50", "outOfRange", "unavailable")


@pytest.mark.slow
@pytest.mark.parametrize("number", NAMES)
def test_containers_have_the_bytes_of_etsis_modules(number: int, modules: Any) -> None:
    _, kind = CONTAINERS[number]

    @settings(max_examples=60, suppress_health_check=list(HealthCheck))
    @given(values_of(kind))
    def check(value: Any) -> None:
        content = encode(kind, value, NAMES[number])
        assert decode(kind, content) == value
        assert modules.encode(NAMES[number], as_asn1tools(value)).hex() == content.hex()

    check()


@pytest.mark.slow
def test_a_whole_message_has_the_bytes_of_etsis_modules(modules: Any) -> None:
    [content] = encode_cpm(STATION, T_NS, to_cpm(street())["perceptionRegionContainer"], OBJECTS)
    message = modules.decode("CollectivePerceptionMessage", content)
    wrapped = message["payload"]["cpmContainers"]
    assert [each["containerId"] for each in wrapped] == [1, 4, 5]
    assert message["payload"]["managementContainer"]["referenceTime"] == 94_694_401_000
    for each, ours in zip(wrapped, decode_cpm(content)["payload"]["cpmContainers"], strict=True):
        [value] = ours.values()
        assert modules.encode(NAMES[each["containerId"]], as_asn1tools(value)) == each["containerData"]
    assert modules.encode("CollectivePerceptionMessage", message) == content


OBJECTS = Detections(
    np.array([[10.0, -4.0, 0.7, 4.2, 1.8, 1.5, 0.2], [-7.0, 3.0, 0.9, 0.5, 0.6, 1.7, 1.0]]),
    np.array([ObjectKind.CAR, ObjectKind.PEDESTRIAN], np.uint8), np.array([9, 4], np.int32),
)  # fmt: skip


def test_a_message_says_what_the_dictionary_says() -> None:
    [content] = encode_cpm(STATION, T_NS, to_cpm(street())["perceptionRegionContainer"], OBJECTS)
    message = decode_cpm(content)
    assert message["header"] == {"protocolVersion": 2, "messageId": 14, "stationId": 4711}
    management = message["payload"]["managementContainer"]
    assert management["referenceTime"] == 94_694_401_000
    assert management["referencePosition"]["latitude"] == 404406000
    assert management["referencePosition"]["altitude"]["altitudeValue"] == 23050
    vehicle, regions, objects = message["payload"]["cpmContainers"]
    # Clockwise from north, where x of the level frame is 17.2° counter-clockwise from east.
    assert vehicle["originatingVehicleContainer"]["orientationAngle"]["value"] == 900 - 172
    assert len(regions["perceptionRegionContainer"]) == 1
    first, second = objects["perceivedObjectContainer"]["perceivedObjects"]
    c, s = np.cos(np.radians(17.2)), np.sin(np.radians(17.2))
    assert first["position"]["xCoordinate"]["value"] == round(100 * (10 * c + 4 * s))
    assert first["position"]["yCoordinate"]["value"] == round(100 * (10 * s - 4 * c))
    assert first["angles"]["zAngle"]["value"] == 172 + 115
    assert [first[f"objectDimension{axis}"]["value"] for axis in "XYZ"] == [42, 18, 15]
    assert first["classification"][0]["objectClass"] == {"vehicleSubClass": 5}
    assert second["classification"][0]["objectClass"] == {"vruSubClass": {"pedestrian": 0}}


@pytest.mark.parametrize("shape", ["sectors", "polygon"])
@pytest.mark.parametrize("yaw", [0.0, np.radians(30.0), np.radians(-101.5)])
def test_regions_that_come_back_claim_what_was_sent(shape: str, yaw: float) -> None:
    estimate = street()
    sent = to_cpm(estimate, sectors=48, shape=shape)
    [content] = encode_cpm(Station(1, 0.0, 0.0, yaw=yaw), T_NS, sent["perceptionRegionContainer"])
    _, regions = decode_cpm(content)["payload"]["cpmContainers"]
    xy = estimate.grid.centers.reshape(-1, 2)
    c, s = np.cos(yaw), np.sin(yaw)
    east_north = xy @ np.array([[c, s], [-s, c]])
    claimed = claimed_by_cpm(regions, east_north)
    assert (claimed == claimed_by_cpm(sent, xy)).mean() > 0.999
    assert not (claimed & ~estimate.visible().ravel()).any()


def test_a_long_message_is_cut_into_segments_below_the_limit() -> None:
    many = OBJECTS.take(np.arange(200) % 2)
    regions = to_cpm(street(), sectors=64)["perceptionRegionContainer"]
    segments = [decode_cpm(content) for content in encode_cpm(STATION, T_NS, regions, many)]
    assert len(segments) > 1
    assert max(map(len, encode_cpm(STATION, T_NS, regions, many))) <= MAX_BYTES
    numbers = [each["payload"]["managementContainer"]["segmentationInfo"] for each in segments]
    assert numbers == [{"totalMsgNo": len(segments), "thisMsgNo": k + 1} for k in range(len(segments))]
    containers = [inner for each in segments for inner in each["payload"]["cpmContainers"]]
    back = [one for each in containers for one in each.get("perceptionRegionContainer", [])]
    boxes = [
        each["perceivedObjectContainer"]["perceivedObjects"]
        for each in containers
        if "perceivedObjectContainer" in each
    ]
    assert [box["objectId"] for some in boxes for box in some] == list(range(200))
    assert len(back) == len(regions)
    with pytest.raises(ValueError, match="must fit into 8 segments"):
        encode_cpm(STATION, T_NS, regions * 64, many)


def test_nothing_seen_and_nobody_there_is_a_message() -> None:
    [content] = encode_cpm(Station(0, -90.0, 180.0), 0 + T_NS, [], Detections.none())
    assert decode_cpm(content)["payload"]["cpmContainers"][1]["perceivedObjectContainer"]["perceivedObjects"] == []


def refusal(content: bytes) -> str:
    """Return why a message is refused; nothing where it is not."""
    try:
        decode_cpm(content)
    except ValueError as error:
        return str(error)
    return ""


@given(st.binary(max_size=300))
@example(b"")
@example(b"\xff" * 300)
def test_any_bytes_are_a_message_or_one_line(content: bytes) -> None:
    assert "\n" not in refusal(content)


@given(st.data())
def test_a_damaged_message_is_a_message_or_one_line(data: st.DataObject) -> None:
    [content] = encode_cpm(STATION, T_NS, to_cpm(street())["perceptionRegionContainer"], OBJECTS)
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    assert "\n" not in refusal(bytes(damaged[: data.draw(st.integers(1, len(damaged)))]))


def test_what_a_later_version_added_is_skipped() -> None:
    old, new = Record({"a": Integer(0, 7)}, extensible=True), Record({"b": Integer(0, 255)})
    # Extended; a = 5; two more members may be there and the second one is, of one byte, 0x2A; then b = 9.
    bits = "1" + "101" + "0" + "000001" + "01" + "00000001" + "00101010" + "00001001"
    content = int(bits.ljust(40, "0"), 2).to_bytes(5, "big")
    both = Record({"old": old, "new": new})
    assert decode(both, content) == {"old": {"a": 5}, "new": {"b": 9}}
    with pytest.raises(ValueError, match="no longer lists than this version knows"):
        decode(SequenceOf(Integer(0, 1), 1, 2), b"\x80")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"measurementDeltaTime": 4000}, r"\[-2048, 2047\], got 4000"),
        ({"perceptionRegionConfidence": "high"}, "got 'high'"),
        ({"perceptionRegionShape": {"square": {}}}, "must be one of rectangular, .*, got {'square'"),
        ({"colour": 3}, "must have the members measurementDeltaTime, .*"),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, Any], complaint: str) -> None:
    region = to_cpm(street())["perceptionRegionContainer"][0] | change
    with pytest.raises((ValueError, KeyError), match=complaint):
        encode(CONTAINERS[4][1], [region], "regions")


def test_a_station_out_of_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match=r"latitude_deg must lie in \[-90, 90\], got 91"):
        Station(1, 91.0, 0.0)
    with pytest.raises(ValueError, match="stationId must be a whole number"):
        encode_cpm(Station(-1, 0.0, 0.0), T_NS)
    other = {"header": {"protocolVersion": 2, "messageId": 2, "stationId": 1}}
    with pytest.raises(ValueError, match="must be a CPM"):
        decode_cpm(encode(MESSAGE, decode_cpm(encode_cpm(STATION, T_NS)[0]) | other, "message"))


def test_objects_and_sizes_that_do_not_fit_are_named() -> None:
    boxes = np.tile([4.0, -2.0, 0.8, 4.2, 1.8, 1.5, 0.3], (257, 1))
    boxes[3, 3] = 40.0
    many = Detections(boxes, np.full(257, ObjectKind.CAR), np.zeros(257, np.int32))
    with (
        pytest.warns(UserWarning, match="at most 255 objects: the last 2 are left out"),
        pytest.warns(UserWarning, match=r"sizes up to 25\.4 m, got 1 objects that are larger"),
    ):
        contents = encode_cpm(STATION, T_NS, (), many)
    [sent] = {decode_cpm(each)["payload"]["cpmContainers"][1]["perceivedObjectContainer"]["numberOfPerceivedObjects"]
              for each in contents}  # fmt: skip
    assert sent == 255


def test_an_estimate_with_a_position_is_a_whole_message() -> None:
    """In Hamburg, 0.995° east of the meridian of its zone, grid north lies 0.8° east of north."""
    pytest.importorskip("rasterio", reason="rasterio is not installed: no place on earth")
    placed = replace(street(), world_from_level=HAMBURG, t_ns=T_NS)
    message = decode_cpm(to_cpm_uper(placed, "EPSG:25832"))
    place = message["payload"]["managementContainer"]["referencePosition"]
    assert [place[name] / 1e7 for name in ("longitude", "latitude")] == pytest.approx([9.9953, 53.5148], abs=1e-4)
    heading = message["payload"]["cpmContainers"][0]["originatingVehicleContainer"]["orientationAngle"]["value"]
    assert heading == pytest.approx(900 - np.degrees(0.4) * 10 + 8.0, abs=1.0)
    for lacking, what in (({"t_ns": None}, "time"), ({"world_from_level": None}, "pose")):
        with pytest.raises(ValueError, match=f"got no {what}; give --poses and --crs"):
            to_cpm_uper(replace(placed, **lacking), "EPSG:25832")
    with pytest.raises(ValueError, match="got no crs"):
        to_cpm_uper(placed)

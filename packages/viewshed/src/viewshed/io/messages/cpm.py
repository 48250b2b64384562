"""Encode and decode Collective Perception Messages (ETSI TS 103 324 V2.1.1): perception regions and objects.

Types and members are those of the ASN.1 modules CPM-PDU-Descriptions and ETSI-ITS-CDD (TS 102 894-2 V2.4.1), in our
own tables. The decoder skips other containers.
"""

from __future__ import annotations

import calendar
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viewshed.detections import Detections, ObjectKind, moved_boxes
from viewshed.geometry import Rigid
from viewshed.io.messages.uper import Boolean, Choice, Integer, OpenType, Record, SequenceOf, Type, decode, encode

MAX_BYTES = 1300
"""Maximum size of a segment: fits into one ITS-G5 packet with headers and signature."""

_BYTE, _TWO_BYTES, _ANGLE, _CONFIDENCE = Integer(0, 255), Integer(0, 65535), Integer(0, 3601), Integer(1, 127)
_DELAY_MS, _LENGTH_DM = Integer(-2048, 2047), Integer(0, 4095)
_COORDINATE, _SMALL_COORDINATE = Integer(-32768, 32767), Integer(-3094, 1001)
_IDS, _PERCENT = SequenceOf(_BYTE, 1, 128), Integer(1, 101)
_POINT = Record({"xCoordinate": _COORDINATE, "yCoordinate": _COORDINATE, "zCoordinate?": _COORDINATE})
_RADIAL: dict[str, Type] = {
    "range": _LENGTH_DM, "horizontalOpeningAngleStart": _ANGLE, "horizontalOpeningAngleEnd": _ANGLE,
    "verticalOpeningAngleStart?": _ANGLE, "verticalOpeningAngleEnd?": _ANGLE,
}  # fmt: skip


def _shape(**members: Type) -> Record:
    return Record({"shapeReferencePoint?": _POINT, **members, "height?": _LENGTH_DM})


def _measured(low: int, high: int, confidence: Type = _CONFIDENCE) -> Record:
    return Record({"value": Integer(low, high), "confidence": confidence})


def _vector(member: str, of: Record) -> Record:
    return Record({f"x{member}": of, f"y{member}": of, f"z{member}?": of})


_MEASURED_ANGLE, _POSITION = _measured(0, 3601), _measured(-131072, 131071, Integer(1, 4096))
_SPEED, _ACCELERATION = _measured(-16383, 16383), _measured(-160, 161, Integer(0, 102))
_SIZE = _measured(1, 256, Integer(1, 32))
SHAPE = Choice({
    "rectangular": Record({
        "shapeReferencePoint?": _POINT, "semiLength": _LENGTH_DM, "semiBreadth": _LENGTH_DM, "orientation?": _ANGLE,
        "height?": _LENGTH_DM,
    }),
    "circular": _shape(radius=_LENGTH_DM),
    "polygonal": _shape(polygon=SequenceOf(_POINT, 3, 16)),
    "elliptical": Record({
        "shapeReferencePoint?": _POINT, "semiMajorAxisLength": _LENGTH_DM, "semiMinorAxisLength": _LENGTH_DM,
        "orientation?": _ANGLE, "height?": _LENGTH_DM,
    }),
    "radial": Record({"shapeReferencePoint?": _POINT} | _RADIAL),
    "radialShapes": Record({
        "refPointId": _BYTE, "xCoordinate": _SMALL_COORDINATE, "yCoordinate": _SMALL_COORDINATE,
        "zCoordinate?": _SMALL_COORDINATE,
        "radialShapesList": SequenceOf(Record(_RADIAL), 1, 16),
    }),
})  # fmt: skip
REGION = Record({
    "measurementDeltaTime": _DELAY_MS, "perceptionRegionConfidence": _PERCENT, "perceptionRegionShape": SHAPE,
    "shadowingApplies": Boolean(), "sensorIdList?": _IDS, "numberOfPerceivedObjects?": _BYTE,
    "perceivedObjectIds?": SequenceOf(_TWO_BYTES, 0, 255),
}, extensible=True)  # fmt: skip
_KIND = Choice({
    "vehicleSubClass": Integer(0, 14),
    "vruSubClass": Choice(dict.fromkeys(
        ("pedestrian", "bicyclistAndLightVruVehicle", "motorcyclist", "animal"), Integer(0, 15)
    )),
    "groupSubClass": Record({
        "clusterId?": _BYTE, "clusterBoundingBoxShape?": SHAPE, "clusterCardinalitySize": _BYTE,
        "clusterProfiles?": Integer(0, 15),
    }, extensible=True),
    "otherSubClass": _BYTE,
})  # fmt: skip
_MATRIX = Record({
    "componentsIncludedIntheMatrix": Record({"bits": Integer(0, (1 << 13) - 1)}, extensible=True),
    "matrix": SequenceOf(SequenceOf(Integer(-100, 101), 1, 13), 1, 13),
})  # fmt: skip
_ROAD_ID = Record({"region?": _TWO_BYTES, "id": _TWO_BYTES})
OBJECT = Record({
    "objectId?": _TWO_BYTES, "measurementDeltaTime": _DELAY_MS, "position": _vector("Coordinate", _POSITION),
    "velocity?": Choice({
        "polarVelocity": Record({
            "velocityMagnitude": Record({"speedValue": Integer(0, 16383), "speedConfidence": _CONFIDENCE}),
            "velocityDirection": _MEASURED_ANGLE, "zVelocity?": _SPEED,
        }),
        "cartesianVelocity": _vector("Velocity", _SPEED),
    }, extensible=False),
    "acceleration?": Choice({
        "polarAcceleration": Record({
            "accelerationMagnitude": Record({
                "accelerationMagnitudeValue": Integer(0, 161), "accelerationConfidence": Integer(0, 102)
            }),
            "accelerationDirection": _MEASURED_ANGLE, "zAcceleration?": _ACCELERATION,
        }),
        "cartesianAcceleration": _vector("Acceleration", _ACCELERATION),
    }, extensible=False),
    "angles?": Record({"zAngle": _MEASURED_ANGLE, "yAngle?": _MEASURED_ANGLE, "xAngle?": _MEASURED_ANGLE}),
    "zAngularVelocity?": _measured(-255, 256, Integer(0, 7)),
    "lowerTriangularCorrelationMatrices?": SequenceOf(_MATRIX, 1, 4, extensible=False),
    "objectDimensionZ?": _SIZE, "objectDimensionY?": _SIZE, "objectDimensionX?": _SIZE, "objectAge?": Integer(0, 2047),
    "objectPerceptionQuality?": Integer(0, 15), "sensorIdList?": _IDS,
    "classification?": SequenceOf(Record({"objectClass": _KIND, "confidence": _PERCENT}), 1, 8, extensible=False),
    "mapPosition?": Record({
        "mapReference?": Choice({"roadsegment": _ROAD_ID, "intersection": _ROAD_ID}, extensible=False),
        "laneId?": _BYTE, "connectionId?": _BYTE,
        "longitudinalLanePosition?": Record({
            "longitudinalLanePositionValue": Integer(0, 32767), "longitudinalLanePositionConfidence": Integer(0, 1023)
        }),
    }, extensible=True),
}, extensible=True)  # fmt: skip
CONTAINERS: dict[int, tuple[str, Type]] = {
    1: ("originatingVehicleContainer", Record({
        "orientationAngle": _MEASURED_ANGLE, "pitchAngle?": _MEASURED_ANGLE, "rollAngle?": _MEASURED_ANGLE,
        "trailerDataSet?": SequenceOf(Boolean(), 0, 0),  # placeholder for trailers: nothing after them is read
    }, extensible=True)),
    4: ("perceptionRegionContainer", SequenceOf(REGION, 1, 256)),
    5: ("perceivedObjectContainer", Record(
        {"numberOfPerceivedObjects": _BYTE, "perceivedObjects": SequenceOf(OBJECT, 0, 255)}, extensible=True
    )),
}  # fmt: skip
"""Containers that are decoded: vehicle (without trailers), regions, objects."""

_RATE = Record({"mantissa": Integer(1, 100), "exponent": Integer(-5, 2)})
MESSAGE = Record({
    "header": Record({"protocolVersion": _BYTE, "messageId": _BYTE, "stationId": Integer(0, 4294967295)}),
    "payload": Record({
        "managementContainer": Record({
            "referenceTime": Integer(0, 4398046511103),
            "referencePosition": Record({
                "latitude": Integer(-900000000, 900000001), "longitude": Integer(-1800000000, 1800000001),
                "positionConfidenceEllipse": Record({
                    "semiMajorConfidence": _LENGTH_DM, "semiMinorConfidence": _LENGTH_DM, "semiMajorOrientation": _ANGLE
                }),
                "altitude": Record({"altitudeValue": Integer(-100000, 800001), "altitudeConfidence": Integer(0, 15)}),
            }),
            "segmentationInfo?": Record({"totalMsgNo": Integer(1, 8), "thisMsgNo": Integer(1, 8)}),
            "messageRateRange?": Record({"messageRateMin": _RATE, "messageRateMax": _RATE}),
        }, extensible=True),
        "cpmContainers": SequenceOf(OpenType(1, 16, CONTAINERS), 1, 8),
    }, extensible=True),
})  # fmt: skip
"""CollectivePerceptionMessage."""

_PROTOCOL, _CPM, _MAX_SEGMENTS = 2, 14, 8
_MAX_OBJECTS, _MAX_SIZE_M = 255, 25.4  # 255 decimeters means: larger
_EPOCH_S = calendar.timegm((2004, 1, 1, 0, 0, 0))
_LEAPS_S = tuple(
    calendar.timegm((year, month, 1, 0, 0, 0))
    for year, month in ((2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1))
)
_CLASS_OF_KIND: dict[int, dict[str, Any]] = {
    ObjectKind.OTHER: {"otherSubClass": 1},
    ObjectKind.PEDESTRIAN: {"vruSubClass": {"pedestrian": 0}},
    ObjectKind.CYCLIST: {"vruSubClass": {"bicyclistAndLightVruVehicle": 0}},
    ObjectKind.CAR: {"vehicleSubClass": 5},
    ObjectKind.TRUCK: {"vehicleSubClass": 8},
}


@dataclass(frozen=True, slots=True)
class Station:
    """Id of the sender, and position and heading of its ``level`` frame.

    Raises:
        ValueError: an angle or the altitude is out of bounds.
    """

    station_id: int  # of the sender, up to 2³² - 1
    latitude_deg: float  # of the origin (WGS84)
    longitude_deg: float  # of the origin
    altitude_m: float | None = None  # of the origin, or None if unknown
    yaw: float = 0.0  # heading of x of the ``level`` frame, radians counter-clockwise from east

    def __post_init__(self) -> None:
        bounds = {"latitude_deg": (self.latitude_deg, 90.0), "longitude_deg": (self.longitude_deg, 180.0)}
        bounds |= {"yaw": (self.yaw, 7.0), "altitude_m": (self.altitude_m or 0.0, 8000.0)}
        for name, (value, limit) in bounds.items():
            if not abs(value) <= limit:
                raise ValueError(f"{name} must lie in [-{limit:g}, {limit:g}], got {value}")


def encode_cpm(
    station: Station, t_ns: int, regions: Sequence[dict[str, Any]] = (), objects: Detections | None = None
) -> list[bytes]:
    """Encode a message as segments of at most :data:`MAX_BYTES` each.

    Regions and objects are rotated to east and north. Angles are rounded to 0.1°, an error of up to 0.05°, which is
    less than the uncertainty of a heading.

    Args:
        station: the sender.
        t_ns: time of the sweep, nanoseconds since 1970 (UTC).
        regions: ``perceptionRegionContainer`` of :func:`viewshed.io.export.to_cpm`, in the sender's ``level`` frame.
        objects: in the same frame; None omits the container.

    Objects after the 255th are dropped and sizes clipped to 25.5 m ("larger than 25.4 m"), with a warning.

    Raises:
        ValueError: a number is out of range, or more than eight segments are needed.
    """
    if objects is not None:
        _warn_of_limits(objects)
    tenths = round(np.degrees(station.yaw) * 10) % 3600
    parts: list[tuple[str, dict[str, Any]]] = [("perceptionRegionContainer", _rotated(r, tenths)) for r in regions]
    parts += [("perceivedObjectContainer", item) for item in _objects(objects, np.radians(tenths / 10))]
    altitude = 800001 if station.altitude_m is None else round(station.altitude_m * 100)
    management: dict[str, Any] = {
        "referenceTime": _its_time_ms(t_ns),
        "referencePosition": {
            "latitude": round(station.latitude_deg * 1e7), "longitude": round(station.longitude_deg * 1e7),
            "positionConfidenceEllipse": dict.fromkeys(("semiMajorConfidence", "semiMinorConfidence"), 4095)
            | {"semiMajorOrientation": 3601},
            "altitude": {"altitudeValue": altitude, "altitudeConfidence": 15},
        },
    }  # fmt: skip
    orientation: dict[str, Any] = {
        "originatingVehicleContainer": {"orientationAngle": {"value": (900 - tenths) % 3600, "confidence": 127}}
    }

    def message(share: Sequence[tuple[str, dict[str, Any]]], segment: dict[str, int] | None) -> bytes:
        containers: list[dict[str, Any]] = [orientation]
        if own_regions := [part for name, part in share if name == "perceptionRegionContainer"]:
            containers.append({"perceptionRegionContainer": own_regions})
        if objects is not None:
            boxes = [part for name, part in share if name == "perceivedObjectContainer"]
            containers.append({"perceivedObjectContainer": {
                "numberOfPerceivedObjects": min(len(objects), _MAX_OBJECTS), "perceivedObjects": boxes
            }})  # fmt: skip
        head = management if segment is None else management | {"segmentationInfo": segment}
        header: dict[str, Any] = {"protocolVersion": _PROTOCOL, "messageId": _CPM, "stationId": station.station_id}
        payload: dict[str, Any] = {"managementContainer": head, "cpmContainers": containers}
        return encode(MESSAGE, {"header": header, "payload": payload}, "message")

    kinds = {"perceptionRegionContainer": REGION, "perceivedObjectContainer": OBJECT}
    packed_bytes = sum(len(encode(kinds[name], part, name)) - 1 for name, part in parts)
    min_segments = max(1, -(-packed_bytes // MAX_BYTES))
    for count in range(min_segments, _MAX_SEGMENTS + 1):
        shares = [parts[k * len(parts) // count : (k + 1) * len(parts) // count] for k in range(count)]
        numbers = [None] if count == 1 else [{"totalMsgNo": count, "thisMsgNo": k + 1} for k in range(count)]
        segments = [message(share, number) for share, number in zip(shares, numbers, strict=True)]
        if max(map(len, segments)) <= MAX_BYTES:
            return segments
    raise ValueError(
        f"a message must fit into {_MAX_SEGMENTS} segments of {MAX_BYTES} bytes; send fewer regions or objects"
    )


def decode_cpm(content: bytes) -> dict[str, Any]:
    """Decode a message or a segment to a dictionary with the standard's names; axes are east and north.

    Raises:
        ValueError: it is damaged, or not a CPM.
    """
    try:
        message: dict[str, Any] = decode(MESSAGE, content)
    except ValueError as error:
        raise ValueError(f"a CPM of {len(content)} bytes {error}") from error
    header = message["header"]
    if (header["protocolVersion"], header["messageId"]) != (_PROTOCOL, _CPM):
        raise ValueError(
            f"must be a CPM ({_CPM}) of protocol {_PROTOCOL}, got message {header['messageId']} of protocol"
            f" {header['protocolVersion']}"
        )
    return message


def _its_time_ms(t_ns: int) -> int:
    """Convert UTC to TAI-based ITS time: milliseconds since 2004, including the leap seconds since then."""
    seconds = t_ns // 1_000_000_000
    return (t_ns - _EPOCH_S * 1_000_000_000) // 1_000_000 + 1000 * sum(seconds >= leap for leap in _LEAPS_S)


def _rotated(region: dict[str, Any], tenths: int) -> dict[str, Any]:
    """Rotate a region counter-clockwise by tenths of a degree."""
    ((kind, shape),) = region["perceptionRegionShape"].items()
    if kind == "radialShapes":
        angles = ("horizontalOpeningAngleStart", "horizontalOpeningAngleEnd")
        details = [fan | {name: (fan[name] + tenths) % 3600 for name in angles} for fan in shape["radialShapesList"]]
        shape = shape | _rotated_point(shape, tenths) | {"radialShapesList": details}
    else:
        shape = shape | {"polygon": [_rotated_point(point, tenths) for point in shape["polygon"]]}
    return region | {"perceptionRegionShape": {kind: shape}}


def _rotated_point(point: dict[str, int], tenths: int) -> dict[str, int]:
    c, s = np.cos(np.radians(tenths / 10)), np.sin(np.radians(tenths / 10))
    x, y = point["xCoordinate"], point["yCoordinate"]
    return {"xCoordinate": round(c * x - s * y), "yCoordinate": round(s * x + c * y)}


def _warn_of_limits(objects: Detections) -> None:
    if len(objects) > _MAX_OBJECTS:
        left_out = len(objects) - _MAX_OBJECTS
        warnings.warn(f"a CPM has at most {_MAX_OBJECTS} objects: the last {left_out} are left out", stacklevel=3)
    large = (objects.boxes[:_MAX_OBJECTS, 3:6] > _MAX_SIZE_M).any(axis=1).sum()
    if large:
        warnings.warn(f"a CPM has sizes up to {_MAX_SIZE_M} m, got {large} objects that are larger", stacklevel=3)


def _objects(objects: Detections | None, yaw: float) -> list[dict[str, Any]]:
    """Return the first 255 objects with the standard's names, rotated by ``yaw``."""
    if objects is None:
        return []
    boxes = moved_boxes(objects.boxes[:_MAX_OBJECTS], Rigid.from_yaw(yaw))
    rows = []
    for number, (box, kind) in enumerate(zip(boxes, objects.kinds, strict=False)):
        x, y, z, length, width, height, heading = box.tolist()
        sizes = {
            f"objectDimension{axis}": {"value": min(max(round(10 * size), 1), 255), "confidence": 32}
            for axis, size in zip("ZYX", (height, width, length), strict=True)
        }
        rows.append({
            "objectId": number, "measurementDeltaTime": 0,
            "position": {
                f"{axis}Coordinate": {"value": round(100 * value), "confidence": 4096}
                for axis, value in zip("xyz", (x, y, z), strict=True)
            },
            "angles": {"zAngle": {"value": round(np.degrees(heading) * 10) % 3600, "confidence": 127}},
            **sizes,
            "classification": [{"objectClass": _CLASS_OF_KIND[int(kind)], "confidence": 101}],
        })  # fmt: skip
    return rows

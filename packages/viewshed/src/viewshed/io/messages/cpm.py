"""Collective Perception Messages (ETSI TS 103 324 V2.1.1) as bytes: perception regions and objects of one station.

Types and members are those of the modules CPM-PDU-Descriptions and ETSI-ITS-CDD (TS 102 894-2 V2.4.1), in a table of
our own. Of a message that somebody else sent, other containers are skipped.
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
from viewshed.io.messages.uper import Choice, Flag, Numbered, Record, Several, Type, Whole, decode, encode

MOST_BYTES = 1300
"""Of a message: what fits into one packet of ITS-G5 beside its headers and signature."""

_BYTE, _TWO_BYTES, _ANGLE, _CONFIDENCE = Whole(0, 255), Whole(0, 65535), Whole(0, 3601), Whole(1, 127)
_DELAY_MS, _LENGTH_DM, _COORDINATE, _SMALL = (
    Whole(-2048, 2047),
    Whole(0, 4095),
    Whole(-32768, 32767),
    Whole(-3094, 1001),
)
_IDS, _PERCENT = Several(_BYTE, 1, 128), Whole(1, 101)
_POINT = Record({"xCoordinate": _COORDINATE, "yCoordinate": _COORDINATE, "zCoordinate?": _COORDINATE})
_RADIAL: dict[str, Type] = {
    "range": _LENGTH_DM, "horizontalOpeningAngleStart": _ANGLE, "horizontalOpeningAngleEnd": _ANGLE,
    "verticalOpeningAngleStart?": _ANGLE, "verticalOpeningAngleEnd?": _ANGLE,
}  # fmt: skip


def _shape(**members: Type) -> Record:
    return Record({"shapeReferencePoint?": _POINT, **members, "height?": _LENGTH_DM})


def _measured(low: int, high: int, confidence: Type = _CONFIDENCE) -> Record:
    return Record({"value": Whole(low, high), "confidence": confidence})


def _vector(member: str, of: Record) -> Record:
    return Record({f"x{member}": of, f"y{member}": of, f"z{member}?": of})


_TURN, _PLACE, _SPEED = _measured(0, 3601), _measured(-131072, 131071, Whole(1, 4096)), _measured(-16383, 16383)
_FASTER, _SIZE = _measured(-160, 161, Whole(0, 102)), _measured(1, 256, Whole(1, 32))
SHAPE = Choice({
    "rectangular": Record({
        "shapeReferencePoint?": _POINT, "semiLength": _LENGTH_DM, "semiBreadth": _LENGTH_DM, "orientation?": _ANGLE,
        "height?": _LENGTH_DM,
    }),
    "circular": _shape(radius=_LENGTH_DM),
    "polygonal": _shape(polygon=Several(_POINT, 3, 16)),
    "elliptical": Record({
        "shapeReferencePoint?": _POINT, "semiMajorAxisLength": _LENGTH_DM, "semiMinorAxisLength": _LENGTH_DM,
        "orientation?": _ANGLE, "height?": _LENGTH_DM,
    }),
    "radial": Record({"shapeReferencePoint?": _POINT} | _RADIAL),
    "radialShapes": Record({
        "refPointId": _BYTE, "xCoordinate": _SMALL, "yCoordinate": _SMALL, "zCoordinate?": _SMALL,
        "radialShapesList": Several(Record(_RADIAL), 1, 16),
    }),
})  # fmt: skip
REGION = Record({
    "measurementDeltaTime": _DELAY_MS, "perceptionRegionConfidence": _PERCENT, "perceptionRegionShape": SHAPE,
    "shadowingApplies": Flag(), "sensorIdList?": _IDS, "numberOfPerceivedObjects?": _BYTE,
    "perceivedObjectIds?": Several(_TWO_BYTES, 0, 255),
}, extensible=True)  # fmt: skip
_KIND = Choice({
    "vehicleSubClass": Whole(0, 14),
    "vruSubClass": Choice(dict.fromkeys(
        ("pedestrian", "bicyclistAndLightVruVehicle", "motorcyclist", "animal"), Whole(0, 15)
    )),
    "groupSubClass": Record({
        "clusterId?": _BYTE, "clusterBoundingBoxShape?": SHAPE, "clusterCardinalitySize": _BYTE,
        "clusterProfiles?": Whole(0, 15),
    }, extensible=True),
    "otherSubClass": _BYTE,
})  # fmt: skip
_MATRIX = Record({
    "componentsIncludedIntheMatrix": Record({"bits": Whole(0, (1 << 13) - 1)}, extensible=True),
    "matrix": Several(Several(Whole(-100, 101), 1, 13), 1, 13),
})  # fmt: skip
_STREET = Record({"region?": _TWO_BYTES, "id": _TWO_BYTES})
OBJECT = Record({
    "objectId?": _TWO_BYTES, "measurementDeltaTime": _DELAY_MS, "position": _vector("Coordinate", _PLACE),
    "velocity?": Choice({
        "polarVelocity": Record({
            "velocityMagnitude": Record({"speedValue": Whole(0, 16383), "speedConfidence": _CONFIDENCE}),
            "velocityDirection": _TURN, "zVelocity?": _SPEED,
        }),
        "cartesianVelocity": _vector("Velocity", _SPEED),
    }, extensible=False),
    "acceleration?": Choice({
        "polarAcceleration": Record({
            "accelerationMagnitude": Record({
                "accelerationMagnitudeValue": Whole(0, 161), "accelerationConfidence": Whole(0, 102)
            }),
            "accelerationDirection": _TURN, "zAcceleration?": _FASTER,
        }),
        "cartesianAcceleration": _vector("Acceleration", _FASTER),
    }, extensible=False),
    "angles?": Record({"zAngle": _TURN, "yAngle?": _TURN, "xAngle?": _TURN}),
    "zAngularVelocity?": _measured(-255, 256, Whole(0, 7)),
    "lowerTriangularCorrelationMatrices?": Several(_MATRIX, 1, 4, extensible=False),
    "objectDimensionZ?": _SIZE, "objectDimensionY?": _SIZE, "objectDimensionX?": _SIZE, "objectAge?": Whole(0, 2047),
    "objectPerceptionQuality?": Whole(0, 15), "sensorIdList?": _IDS,
    "classification?": Several(Record({"objectClass": _KIND, "confidence": _PERCENT}), 1, 8, extensible=False),
    "mapPosition?": Record({
        "mapReference?": Choice({"roadsegment": _STREET, "intersection": _STREET}, extensible=False),
        "laneId?": _BYTE, "connectionId?": _BYTE,
        "longitudinalLanePosition?": Record({
            "longitudinalLanePositionValue": Whole(0, 32767), "longitudinalLanePositionConfidence": Whole(0, 1023)
        }),
    }, extensible=True),
}, extensible=True)  # fmt: skip
CONTAINERS: dict[int, tuple[str, Type]] = {
    1: ("originatingVehicleContainer", Record({
        "orientationAngle": _TURN, "pitchAngle?": _TURN, "rollAngle?": _TURN,
        "trailerDataSet?": Several(Flag(), 0, 0),  # stands for trailers: nothing behind them in this container is read
    }, extensible=True)),
    4: ("perceptionRegionContainer", Several(REGION, 1, 256)),
    5: ("perceivedObjectContainer", Record(
        {"numberOfPerceivedObjects": _BYTE, "perceivedObjects": Several(OBJECT, 0, 255)}, extensible=True
    )),
}  # fmt: skip
"""Those that are read: of a vehicle (not its trailers), regions, objects."""

_RATE = Record({"mantissa": Whole(1, 100), "exponent": Whole(-5, 2)})
MESSAGE = Record({
    "header": Record({"protocolVersion": _BYTE, "messageId": _BYTE, "stationId": Whole(0, 4294967295)}),
    "payload": Record({
        "managementContainer": Record({
            "referenceTime": Whole(0, 4398046511103),
            "referencePosition": Record({
                "latitude": Whole(-900000000, 900000001), "longitude": Whole(-1800000000, 1800000001),
                "positionConfidenceEllipse": Record({
                    "semiMajorConfidence": _LENGTH_DM, "semiMinorConfidence": _LENGTH_DM, "semiMajorOrientation": _ANGLE
                }),
                "altitude": Record({"altitudeValue": Whole(-100000, 800001), "altitudeConfidence": Whole(0, 15)}),
            }),
            "segmentationInfo?": Record({"totalMsgNo": Whole(1, 8), "thisMsgNo": Whole(1, 8)}),
            "messageRateRange?": Record({"messageRateMin": _RATE, "messageRateMax": _RATE}),
        }, extensible=True),
        "cpmContainers": Several(Numbered(1, 16, CONTAINERS), 1, 8),
    }, extensible=True),
})  # fmt: skip
"""CollectivePerceptionMessage."""

_PROTOCOL, _CPM, _MOST_SEGMENTS = 2, 14, 8
_MOST_OBJECTS, _MOST_SIZE_M = 255, 25.4  # a size of 255 decimeters says: larger
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
    """Who sends, and where the origin of its ``level`` frame lies.

    Raises:
        ValueError: an angle or the altitude is out of bounds.
    """

    station_id: int  # of the sender, up to 2³² - 1
    latitude_deg: float  # of the origin (WGS84)
    longitude_deg: float  # of the origin
    altitude_m: float | None = None  # of the origin, or None where it is not known
    yaw: float = 0.0  # heading of x of the ``level`` frame, radians counter-clockwise from east

    def __post_init__(self) -> None:
        bounds = {"latitude_deg": (self.latitude_deg, 90.0), "longitude_deg": (self.longitude_deg, 180.0)}
        bounds |= {"yaw": (self.yaw, 7.0), "altitude_m": (self.altitude_m or 0.0, 8000.0)}
        for name, (value, most) in bounds.items():
            if not abs(value) <= most:
                raise ValueError(f"{name} must lie in [-{most:g}, {most:g}], got {value}")


def encode_cpm(
    station: Station, t_ns: int, regions: Sequence[dict[str, Any]] = (), objects: Detections | None = None
) -> list[bytes]:
    """Return a message as segments, each of at most :data:`MOST_BYTES`.

    The axes of regions and objects are turned to east and north. Angles are whole tenths of a degree, so that a region
    turns by up to 0.05°: less than a heading is known.

    Args:
        station: who sends.
        t_ns: time of the sweep, nanoseconds since 1970 (UTC).
        regions: ``perceptionRegionContainer`` of :func:`viewshed.io.export.to_cpm`, of the sender's ``level`` frame.
        objects: in the same frame; None leaves the container out.

    More than 255 objects, and sizes beyond 25.4 m, do not fit: a warning says what is left out.

    Raises:
        ValueError: a number does not fit, or it takes more than eight segments.
    """
    if objects is not None:
        _warn_of_what_does_not_fit(objects)
    tenths = round(np.degrees(station.yaw) * 10) % 3600
    parts: list[tuple[str, dict[str, Any]]] = [("perceptionRegionContainer", _turned(each, tenths)) for each in regions]
    parts += [("perceivedObjectContainer", each) for each in _objects(objects, np.radians(tenths / 10))]
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

    def message(part: Sequence[tuple[str, dict[str, Any]]], segment: dict[str, int] | None) -> bytes:
        contained: list[dict[str, Any]] = [orientation]
        if inside := [each for name, each in part if name == "perceptionRegionContainer"]:
            contained.append({"perceptionRegionContainer": inside})
        if objects is not None:
            boxes = [each for name, each in part if name == "perceivedObjectContainer"]
            contained.append({"perceivedObjectContainer": {
                "numberOfPerceivedObjects": min(len(objects), _MOST_OBJECTS), "perceivedObjects": boxes
            }})  # fmt: skip
        head = management if segment is None else management | {"segmentationInfo": segment}
        header: dict[str, Any] = {"protocolVersion": _PROTOCOL, "messageId": _CPM, "stationId": station.station_id}
        payload: dict[str, Any] = {"managementContainer": head, "cpmContainers": contained}
        return encode(MESSAGE, {"header": header, "payload": payload}, "message")

    kinds = {"perceptionRegionContainer": REGION, "perceivedObjectContainer": OBJECT}
    packed = sum(len(encode(kinds[name], part, name)) - 1 for name, part in parts)
    least = max(1, -(-packed // MOST_BYTES))
    for count in range(least, _MOST_SEGMENTS + 1):
        shares = [parts[k * len(parts) // count : (k + 1) * len(parts) // count] for k in range(count)]
        numbers = [None] if count == 1 else [{"totalMsgNo": count, "thisMsgNo": k + 1} for k in range(count)]
        segments = [message(share, number) for share, number in zip(shares, numbers, strict=True)]
        if max(map(len, segments)) <= MOST_BYTES:
            return segments
    raise ValueError(
        f"a message must fit into {_MOST_SEGMENTS} segments of {MOST_BYTES} bytes; send fewer regions or objects"
    )


def decode_cpm(content: bytes) -> dict[str, Any]:
    """Return a message, or a segment of one, as a dictionary with the standard's names; its axes are east and north.

    Raises:
        ValueError: it is damaged, or no such message.
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
    """Return milliseconds since 2004 as ITS stations count them: with the leap seconds since then."""
    seconds = t_ns // 1_000_000_000
    return (t_ns - _EPOCH_S * 1_000_000_000) // 1_000_000 + 1000 * sum(seconds >= leap for leap in _LEAPS_S)


def _turned(region: dict[str, Any], tenths: int) -> dict[str, Any]:
    """Return a region turned by tenths of a degree, counter-clockwise."""
    ((kind, shape),) = region["perceptionRegionShape"].items()
    if kind == "radialShapes":
        angles = ("horizontalOpeningAngleStart", "horizontalOpeningAngleEnd")
        details = [each | {name: (each[name] + tenths) % 3600 for name in angles} for each in shape["radialShapesList"]]
        shape = shape | _turned_point(shape, tenths) | {"radialShapesList": details}
    else:
        shape = shape | {"polygon": [_turned_point(point, tenths) for point in shape["polygon"]]}
    return region | {"perceptionRegionShape": {kind: shape}}


def _turned_point(point: dict[str, int], tenths: int) -> dict[str, int]:
    c, s = np.cos(np.radians(tenths / 10)), np.sin(np.radians(tenths / 10))
    x, y = point["xCoordinate"], point["yCoordinate"]
    return {"xCoordinate": round(c * x - s * y), "yCoordinate": round(s * x + c * y)}


def _warn_of_what_does_not_fit(objects: Detections) -> None:
    if len(objects) > _MOST_OBJECTS:
        left_out = len(objects) - _MOST_OBJECTS
        warnings.warn(f"a CPM has at most {_MOST_OBJECTS} objects: the last {left_out} are left out", stacklevel=3)
    large = (objects.boxes[:_MOST_OBJECTS, 3:6] > _MOST_SIZE_M).any(axis=1).sum()
    if large:
        warnings.warn(f"a CPM has sizes up to {_MOST_SIZE_M} m, got {large} objects that are larger", stacklevel=3)


def _objects(objects: Detections | None, yaw: float) -> list[dict[str, Any]]:
    """Return the first 255 objects with the standard's names, turned by ``yaw``."""
    if objects is None:
        return []
    boxes = moved_boxes(objects.boxes[:_MOST_OBJECTS], Rigid.from_yaw(yaw))
    made = []
    for number, (box, kind) in enumerate(zip(boxes, objects.kinds, strict=False)):
        x, y, z, length, width, height, heading = box.tolist()
        sizes = {
            f"objectDimension{axis}": {"value": min(max(round(10 * size), 1), 255), "confidence": 32}
            for axis, size in zip("ZYX", (height, width, length), strict=True)
        }
        made.append({
            "objectId": number, "measurementDeltaTime": 0,
            "position": {
                f"{axis}Coordinate": {"value": round(100 * value), "confidence": 4096}
                for axis, value in zip("xyz", (x, y, z), strict=True)
            },
            "angles": {"zAngle": {"value": round(np.degrees(heading) * 10) % 3600, "confidence": 127}},
            **sizes,
            "classification": [{"objectClass": _CLASS_OF_KIND[int(kind)], "confidence": 101}],
        })  # fmt: skip
    return made

"""Classes of objects that a pixel can show."""

from enum import IntEnum


class ObjectId(IntEnum):
    """Class of the object that a pixel shows, as stored in `StripeCapture.object_id`."""

    BACKGROUND = 0
    TISSUE = 1
    TOOL = 2
    STAGE = 3
    OTHER = 4


_BY_PREFIX = {"tool_arm/": ObjectId.TOOL, "stage/": ObjectId.STAGE}


def object_id_of_geom(name: str) -> ObjectId:
    """Return the class of a rigid geom by the prefix of its name."""
    return next((found for prefix, found in _BY_PREFIX.items() if name.startswith(prefix)), ObjectId.OTHER)

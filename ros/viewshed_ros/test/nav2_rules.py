"""What nav2's two costmap filters make of a mask, by their documentation and sources; the robot is at (x, y)."""

from nav_msgs.msg import OccupancyGrid


def value_at(mask: OccupancyGrid, x: float, y: float) -> int:
    """Return the value of the cell; -1 outside."""
    info = mask.info
    column = int((x - info.origin.position.x) // info.resolution)
    row = int((y - info.origin.position.y) // info.resolution)
    inside = 0 <= column < info.width and 0 <= row < info.height
    return int(mask.data[row * info.width + column]) if inside else -1


def speed_percent(mask: OccupancyGrid, x: float, y: float, before: int) -> int:
    """SpeedFilter: -1 is skipped, the limit before holds; 0 is no limit; else percent of the greatest speed."""
    return before if (value := value_at(mask, x, y)) == -1 else value or 100


def is_kept_out(mask: OccupancyGrid, x: float, y: float) -> bool:
    """KeepoutFilter: -1 is skipped; 100 is lethal."""
    return value_at(mask, x, y) == 100

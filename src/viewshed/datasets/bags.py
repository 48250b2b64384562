"""ROS 1 bags, ROS 2 bags and MCAP files: PointCloud2 as sweeps, poses from tf and odometry."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from viewshed.datasets.bag_files import BagFile, bags_in, decoder, open_bag
from viewshed.datasets.bag_scan import CLOUD, Bag, one_line, scan_bag
from viewshed.datasets.pointcloud2 import sweep_of_cloud
from viewshed.datasets.source import ObjectBox, SweepRef
from viewshed.sweep import Sweep

LAYOUT = "a .bag or .mcap file, a folder with metadata.yaml, or a folder of these"


class BagRecording:
    """One bag or several, from :meth:`open`; each is a scene, each topic of PointCloud2 an agent.

    One pass over a bag lists its clouds and takes its transforms; the clouds themselves are read when asked for.

    Args:
        bags: name → bag.
        damage: what was found wrong.
    """

    def __init__(self, bags: dict[str, Bag], damage: tuple[str, ...] = ()) -> None:
        self._bags = bags
        self._damage = damage
        self._open: dict[str, BagFile] = {}
        self._process = os.getpid()

    def __getstate__(self) -> tuple[dict[str, Bag], tuple[str, ...]]:
        return self._bags, self._damage

    def __setstate__(self, state: tuple[dict[str, Bag], tuple[str, ...]]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    @classmethod
    def open(cls, place: Path) -> BagRecording:
        """Return the bags at a place.

        Raises:
            ValueError: there is none, or none of them has a cloud; one line that says why.
            ImportError: the extra ``bags`` is not installed.
            OSError: it cannot be read.
        """
        decoder("cdr")
        damage: dict[str, None] = {}
        bags: dict[str, Bag] = {}
        for path in bags_in(place) or [place]:
            said: list[str] = []
            scene = path.stem if path.stem not in bags else path.name
            bag = scan_bag(scene, path, said)
            damage |= dict.fromkeys(f"{path}: {line}" for line in said)
            if bag is not None:
                bags[scene] = bag
        if not bags:
            raise ValueError("; ".join(damage))
        return cls(bags, tuple(damage))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the bags, without their endings."""
        return tuple(self._bags)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the clouds of a bag in the order of their headers' times.

        Raises:
            ValueError: there is no such bag.
        """
        return self._bag(scene).refs

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep in the frame of its header, with its pose where transforms lead to it.

        Raises:
            ValueError: the message is damaged; one line that names the file and the topic.
            OSError: the bag cannot be read.
        """
        bag = self._bag(ref.scene)
        try:
            cloud = decoder(bag.encoding)(self._file(bag).message(ref.key), CLOUD)
            sweep = sweep_of_cloud(cloud)
        except OSError:
            raise
        except Exception as error:  # the decoder of rosbags raises a dozen types on damaged messages
            raise ValueError(f"{ref.file}: {ref.sensor} at {ref.t_ns} ns: {one_line(error)}") from error
        return sweep.replace(
            agent=ref.agent, t_ns=ref.t_ns, world_from_sensor=bag.poses[ref.index],
            sensor_height_m=bag.heights_m[ref.index],
        )  # fmt: skip

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return None: bags hold no annotations that are read."""
        self._bag(ref.scene)
        return None

    def damage(self) -> tuple[str, ...]:
        """Return what is wrong with the bags: damaged ones, empty topics, sweeps without a pose."""
        return self._damage

    def _bag(self, scene: str) -> Bag:
        if scene not in self._bags:
            raise ValueError(f"scene must be one of {', '.join(self._bags)}, got {scene!r}")
        return self._bags[scene]

    def _file(self, bag: Bag) -> BagFile:
        """Return the opened bag; only one is kept open, and none that another process opened."""
        if self._process != os.getpid():
            self._open, self._process = {}, os.getpid()
        name = str(bag.path)
        if name not in self._open:
            for file in self._open.values():
                file.close()
            self._open = {name: open_bag(bag.path)}
        return self._open[name]


def is_bag(place: Path) -> bool:
    """Return whether a place is a bag or a folder of bags, by names alone."""
    return bool(bags_in(place))

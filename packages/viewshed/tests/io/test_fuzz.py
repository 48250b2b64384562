"""Random damage to small valid files: a sweep or one clear line that names the file, nothing else.

More examples, drawn by chance: ``VIEWSHED_HYPOTHESIS=random pytest packages/viewshed/tests/io/test_fuzz.py``.
"""

import json
import tempfile
import time
import tracemalloc
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viewshed.io import read_index, read_sweeps
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep

pytestmark = pytest.mark.slow

files: Any = import_module("sweep_files")
recordings: Any = import_module("recording_files")
RECORDING, FLOOR_BYTES, RATIO = "recording", 64_000_000, 10
NUSCENES, KITTI = "v1.0-mini/", "2011_09_26/2011_09_26_drive_0001_sync/"
SPOILED = {
    "opv2v": ("s/641/000068.yaml", "s/data_protocol.yaml"), "kitti_raw": (f"{KITTI}tracklet_labels.xml",),
    "nuscenes": tuple(f"{NUSCENES}{table}.json" for table in ("sample_data", "ego_pose", "sample_annotation")),
    "carla": ("recording.json", "actors.jsonl", "car/poses.csv"), "ros1 bag": ("a.bag",), "db3": ("a.db3",),
    "mcap": ("a.mcap",), "argoverse2": ("log/city_SE3_egovehicle.feather", "log/annotations.feather"),
}  # fmt: skip
"""Recording → its files that are damaged."""
WORDS = (
    b"-1", b"0", b"99999999999", b"nan", b"1e999", b"\n", b" ", bytes(8), b"{" * 500, b"[" * 5000, b"%s", b"\xff\xfe",
    b"\x7f", b"\xff" * 2, b"\xff\x7f", b"\xff" * 4, b"\xff\xff\xff\x7f", b"\xff" * 8, b"\xff" * 7 + b"\x7f",
    *(np.float32(number).tobytes() for number in (np.nan, np.inf, -np.inf, 3e38, 1e-40)),
)  # fmt: skip
"""What is hard to read: numbers out of bounds, nesting, numbers that are none."""
DAMAGES = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 9), st.binary(max_size=8) | st.sampled_from(WORDS)),
    min_size=1, max_size=5,
)  # fmt: skip


def cases() -> dict[str, Any]:
    """Return every sample, the metadata beside a capture, files of recordings, and an index of sweeps."""
    found: dict[str, Any] = files.samples()
    capture = {"o.pcap": found["ouster pcap"].content}
    found["ouster metadata"] = files.SampleFile("ouster", "o.json", files.ouster_metadata(), capture)
    for kind, names in SPOILED.items():
        whole = recordings.recordings()[kind]
        for name in names:
            others = {other: content for other, content in whole.items() if other != name}
            found[f"{kind} {name.rsplit('/', 1)[-1]}"] = files.SampleFile(RECORDING, name, whole[name], others)
    index = [{"file": "a.bin", "sensor": "HDL-64E", "sensor_from_file": np.eye(4).tolist(), "t": 1.5}]
    beside = {"a.bin": found["kitti"].content}
    found["index"] = files.SampleFile("index", "index.json", json.dumps(index).encode(), beside)
    return found


CASES = cases()


def damaged(content: bytes, damages: list[tuple[float, int, bytes]]) -> bytes:
    """Return the content with, at each place, some bytes replaced by others; nine bytes or more cut it off there."""
    for place, length, by in damages:
        at = int(place * len(content))
        content = content[:at] + by + (b"" if length == 9 else content[at + length :])
    return content


def read_case(sample: Any, folder: Path, content: bytes, *, auto: bool) -> str | None:
    """Read a damaged sample; return None for a sweep, or the last line that refuses it: one that names the file."""
    path = folder / sample.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    lines: list[str] = []
    try:
        if sample.format == RECORDING:
            read_recording(folder, lines)
        elif sample.format == "index":
            read_index(path)
        else:
            path = folder / next(iter(sample.beside)) if sample.name.endswith(".json") else path
            for sweep in read_sweeps(path, format="auto" if auto else sample.format):
                assert np.isfinite(sweep.points).all()
    except (ValueError, OSError) as error:
        lines.append(str(error))
    named = folder if sample.format == RECORDING else path
    for line in lines:
        assert "\n" not in line, f"two lines: {line!r}"
        assert str(named) in line, f"no file name: {line!r}"
    return lines[-1] if lines else None


def read_recording(folder: Path, lines: list[str]) -> None:
    """Read a recording with a damaged file; what is said of the damage is added to the lines."""
    source = open_source(folder)
    for ref, sweep in each_sweep(source, on_damage=lambda _, line: lines.append(line)):
        assert np.isfinite(sweep.points).all()
        try:
            source.boxes(ref)
        except (ValueError, OSError) as error:
            lines.append(str(error))


@pytest.mark.hypothesis  # `given` is inside
@pytest.mark.parametrize("name", sorted(CASES))
def test_damaged_files_give_a_sweep_or_one_line(name: str) -> None:
    sample = CASES[name]
    with tempfile.TemporaryDirectory() as name_of_folder:
        folder = Path(name_of_folder)
        recordings.write(folder, sample.beside)
        whole = read_case(sample, folder, sample.content, auto=sample.format != "index")
        assert whole is None or "clouds have no pose" in whole
        with tempfile.TemporaryDirectory() as other:
            read_case(CASES["kitti"], Path(other), CASES["kitti"].content, auto=True)

        @settings(max_examples=60)
        @given(damages=DAMAGES, auto=st.booleans())
        def damage(damages: list[tuple[float, int, bytes]], auto: bool) -> None:
            content = damaged(sample.content, damages)
            begin_s = time.process_time()
            tracemalloc.start()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", UserWarning)
                read_case(sample, folder, content, auto=auto)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert time.process_time() - begin_s < 2
            assert peak <= max(FLOOR_BYTES, RATIO * len(content))

        damage()

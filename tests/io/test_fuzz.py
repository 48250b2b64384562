"""Random damage to small valid files: a sweep or one clear line, nothing else. Long runs: tools/fuzz_readers.py."""

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

pytestmark = pytest.mark.slow

fuzz: Any = import_module("fuzz_readers")
CASES = fuzz.cases()
DAMAGES = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 9), st.binary(max_size=8) | st.sampled_from(fuzz.WORDS)),
    min_size=1, max_size=5,
)  # fmt: skip


def damaged(content: bytes, damages: list[tuple[float, int, bytes]]) -> bytes:
    """Return the content with, at each place, some bytes replaced by others; nine bytes or more cut it off there."""
    for place, length, by in damages:
        at = int(place * len(content))
        content = content[:at] + by + (b"" if length == 9 else content[at + length :])
    return content


@pytest.mark.hypothesis  # `given` is inside
@pytest.mark.parametrize("name", sorted(CASES))
def test_damaged_files_give_a_sweep_or_one_line(name: str) -> None:
    sample = CASES[name]
    with tempfile.TemporaryDirectory() as name_of_folder:
        folder = Path(name_of_folder)
        fuzz.write(folder, sample.beside)
        whole = fuzz.read_case(sample, folder, sample.content, auto=sample.format != "index")
        assert whole is None or "clouds have no pose" in whole
        with tempfile.TemporaryDirectory() as other:
            fuzz.read_case(CASES["kitti"], Path(other), CASES["kitti"].content, auto=True)

        @settings(max_examples=60)
        @given(damages=DAMAGES, auto=st.booleans())
        def damage(damages: list[tuple[float, int, bytes]], auto: bool) -> None:
            content = damaged(sample.content, damages)
            begin_s = time.process_time()
            tracemalloc.start()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", UserWarning)
                fuzz.read_case(sample, folder, content, auto=auto)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert time.process_time() - begin_s < 2
            assert peak <= max(fuzz.FLOOR_BYTES, fuzz.RATIO * len(content))

        damage()


def test_damage_is_told_by_its_seed() -> None:
    content = CASES["pcd binary"].content
    first, again, other = (fuzz.mutate(content, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert first != content

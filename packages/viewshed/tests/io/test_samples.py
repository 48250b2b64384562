import io
from importlib import import_module
from typing import Any

import numpy as np

from viewshed.io.samples import junction_truth_path

make_sample: Any = import_module("make_sample")


def test_the_stored_truth_is_the_one_of_the_scene() -> None:
    with np.load(junction_truth_path()) as stored, np.load(io.BytesIO(make_sample.truth_content())) as made:
        assert set(stored) == set(made)
        for name in stored:
            np.testing.assert_array_equal(stored[name], made[name])

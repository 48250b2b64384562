"""A Ray cluster on this machine, started once for all tests of engines."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="session")
def cluster() -> Iterator[Any]:
    """A head node of one core; tests add nodes and kill them."""
    pytest.importorskip("ray", reason="ray is not installed: clusters are not tested")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:  # so that workers find tests.jobs
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[2]), prepend=os.pathsep)
        cluster: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        yield cluster
        cluster.shutdown()

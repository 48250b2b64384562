"""A Ray cluster on this machine, started once for all tests of engines."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[4]))  # so that other processes find tests.jobs.jobs


@pytest.fixture(scope="session")
def cluster() -> Iterator[Any]:
    """A head node of one core; tests add nodes and kill them."""
    pytest.importorskip("ray", reason="ray is not installed: clusters are not tested")
    from ray.cluster_utils import Cluster

    cluster: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield cluster
    cluster.shutdown()

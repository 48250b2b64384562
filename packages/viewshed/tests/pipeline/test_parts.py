"""Where sweeps wait, how long they took, and what their clocks say."""

import threading

import numpy as np
import pytest

from viewshed.pipeline.agent import Agent, Agents
from viewshed.pipeline.inbox import Inbox, RateLimit
from viewshed.pipeline.latency import Latencies
from viewshed.preprocess.streams import AGENTS


def test_agents_take_turns_however_much_one_of_them_sends() -> None:
    inbox: Inbox[str] = Inbox()
    served = []
    for _ in range(30):
        for _ in range(5):
            inbox.put("loud", "loud")
        inbox.put("quiet", "quiet")
        served.append(inbox.take())
    assert served.count("quiet") == served.count("loud") == 15


def test_who_waits_for_room_or_for_an_item_is_woken_by_closing() -> None:
    inbox: Inbox[int] = Inbox(lossless=True)
    inbox.put("car", 1)
    putting = threading.Thread(target=inbox.put, args=("car", 2))
    putting.start()
    inbox.close()
    putting.join(5)
    assert not putting.is_alive()
    assert (inbox.take(), inbox.take()) == (1, None)
    assert inbox.dropped == 1
    inbox.put("car", 3)
    assert inbox.take() is None


def test_a_name_that_is_not_heard_for_ten_seconds_gives_up_its_place() -> None:
    agents, others = Agents(), [f"agent {number}" for number in range(AGENTS - 2)]
    for name in others:
        agents.heard(name, 0.0, Agent, ())

    def is_heard(name: str, now_s: float, *waiting: str) -> bool:
        before, agent = agents.get(name), agents.heard(name, now_s, Agent, [*others, *waiting])
        assert before is None or agent is before
        return agent is not None

    assert is_heard("car", 0.0)
    assert is_heard("mast", 0.0)
    assert is_heard("car", 5.0)
    assert not is_heard("bus", 5.0)
    assert is_heard("bus", 10.0)  # in the place of the mast
    assert not is_heard("mast", 10.0)
    # What waits keeps its place, however long.
    assert not is_heard("mast", 60.0, *agents)
    assert is_heard("mast", 60.0, "car")  # in the place of the bus
    assert "bus" not in agents
    assert is_heard("bus", 60.0)  # in the place of the car
    assert "car" not in agents


def test_quantiles_of_latencies_are_those_of_the_seconds_to_one_percent() -> None:
    seconds = np.random.default_rng(0).lognormal(-4.0, 0.7, 5000)
    taken = Latencies()
    for value in seconds:
        taken.add(value)
    for share in (0.01, 0.5, 0.9, 0.99):
        assert taken.quantile(share) == pytest.approx(np.quantile(seconds, share, method="inverted_cdf"), rel=0.011)
    assert taken.worst_s == seconds.max() >= taken.quantile(1.0)
    assert taken.count == 5000


def test_a_rate_limits_each_agent_by_its_own_times() -> None:
    limit = RateLimit(10.0)
    taken = [
        limit.takes(agent, t_ms * 1_000_000) for agent, t_ms in (("a", 0), ("b", 50), ("a", 80), ("a", 95), ("b", 145))
    ]
    assert taken == [True, True, False, True, True]
    assert limit.takes("a", 5_000_000)  # a recording that begins again
    assert [limit.takes("a", None) for _ in range(2)] == [True, True]
    assert all(RateLimit(0.0).takes("a", t_ns) for t_ns in range(5))


def test_who_has_something_waiting_is_in_the_inbox() -> None:
    inbox: Inbox[int] = Inbox(waiting=2)
    assert "car" not in inbox
    for item in range(2):
        inbox.put("car", item)
    for _ in range(2):
        assert "car" in inbox
        inbox.take()
    assert "car" not in inbox

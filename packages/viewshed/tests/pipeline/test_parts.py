"""Where sweeps wait, how long they took, and what their clocks say."""

import threading

import numpy as np
import pytest

from viewshed.pipeline.clocks import Clocks, RateLimit
from viewshed.pipeline.inbox import Inbox
from viewshed.pipeline.latency import Latencies


def _all(inbox: Inbox[int]) -> list[int]:
    inbox.close()
    return list(iter(inbox.take, None))


def test_the_newest_of_an_agent_wins_and_drops_are_counted() -> None:
    inbox: Inbox[int] = Inbox(waiting=2)
    for item in range(5):
        inbox.put("car", item)
    inbox.put("mast", 7)
    assert _all(inbox) == [3, 7, 4]  # they take turns
    assert inbox.dropped == 3


def test_agents_take_turns_however_much_one_of_them_sends() -> None:
    inbox: Inbox[str] = Inbox()
    served = []
    for _ in range(30):
        for _ in range(5):
            inbox.put("loud", "loud")
        inbox.put("quiet", "quiet")
        served.append(inbox.take())
    assert served.count("quiet") == served.count("loud") == 15


def test_a_lossless_inbox_waits_for_room_and_drops_nothing() -> None:
    inbox: Inbox[int] = Inbox(lossless=True)

    def put_all() -> None:
        for item in range(100):
            inbox.put("car", item)

    thread = threading.Thread(target=put_all)
    thread.start()
    assert [inbox.take() for _ in range(100)] == list(range(100))
    thread.join()
    assert inbox.dropped == 0


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


def test_an_inbox_must_have_room() -> None:
    with pytest.raises(ValueError, match="waiting must be 1 or more, got 0"):
        Inbox(0)


def test_a_flood_of_names_holds_no_more_than_64_agents() -> None:
    inbox: Inbox[int] = Inbox(clock=lambda: 0.0)
    taken = [inbox.put(f"agent {k}", k) for k in range(3000)]
    assert sum(taken) == 64 == taken.index(False)
    assert (inbox.refused, inbox.dropped) == (3000 - 64, 0)
    assert "at most 64 agents within 10 s, got 'agent 2999' as one more" in inbox.note
    # Those that are in go on, also where they have nothing waiting.
    assert inbox.take() == 0
    assert not inbox.put("another", 1)
    assert inbox.put("agent 0", 1)
    assert _all(inbox) == [*range(1, 64), 1]


def test_a_name_that_is_not_heard_for_ten_seconds_gives_up_its_place() -> None:
    now_s = 0.0
    inbox: Inbox[str] = Inbox(agents=2, clock=lambda: now_s)
    for name in ("car", "mast"):
        assert inbox.put(name, name)
        assert inbox.take() == name
    now_s = 5.0
    assert inbox.put("car", "car")
    assert not inbox.put("bus", "bus")
    now_s = 10.0
    assert inbox.put("bus", "bus")  # in the place of the mast
    assert not inbox.put("mast", "mast")
    # What waits keeps its place, however long.
    now_s = 60.0
    assert not inbox.put("mast", "mast")
    assert [inbox.take(), inbox.take()] == ["car", "bus"]
    assert inbox.put("mast", "mast")


def test_quantiles_of_latencies_are_those_of_the_seconds_to_one_percent() -> None:
    seconds = np.random.default_rng(0).lognormal(-4.0, 0.7, 5000)
    taken = Latencies()
    for value in seconds:
        taken.add(value)
    for share in (0.01, 0.5, 0.9, 0.99):
        assert taken.quantile(share) == pytest.approx(np.quantile(seconds, share, method="inverted_cdf"), rel=0.011)
    assert taken.worst_s == seconds.max() >= taken.quantile(1.0)
    assert taken.count == 5000


def test_latencies_of_none_and_of_extremes() -> None:
    taken = Latencies()
    assert taken.line() == "no answer yet"
    taken.add(0.0)
    taken.add(1e9)
    assert taken.count == 2
    assert taken.quantile(0.5) < 2e-5
    one = Latencies()
    one.add(0.0491)
    assert one.line() == "p50 49.1 ms, p99 49.1 ms, worst 49.1 ms"


def test_clocks_notice_what_goes_back_jumps_or_repeats_of_each_agent() -> None:
    clocks = Clocks(agents=2)
    assert clocks.note("car", 0) == ""
    assert clocks.note("car", 100_000_000) == ""
    assert clocks.note("mast", 50_000_000) == ""
    assert clocks.note("car", None) == ""
    with pytest.raises(ValueError, match="got the same again"):
        clocks.note("car", 100_000_000)
    assert clocks.note("car", 40_000_000) == "time went back by 0.06 s: the stream begins anew"
    assert clocks.note("car", 30_040_000_000) == "time jumped by 30 s: the stream begins anew"
    assert clocks.note("third", 1) == ""  # and the mast is forgotten
    assert clocks.note("mast", 50_000_000) == ""


def test_a_rate_limits_each_agent_by_its_own_times() -> None:
    limit = RateLimit(10.0)
    taken = [
        limit.takes(agent, t_ms * 1_000_000) for agent, t_ms in (("a", 0), ("b", 50), ("a", 80), ("a", 95), ("b", 145))
    ]
    assert taken == [True, True, False, True, True]
    assert limit.takes("a", 5_000_000)  # a recording that begins again
    assert [limit.takes("a", None) for _ in range(2)] == [True, True]
    assert all(RateLimit(0.0).takes("a", t_ns) for t_ns in range(5))

"""Which frames of a page stand side by side in a clip: the latest of each agent at each turn of the first."""

from clip import Shown, steps


def _frames(turns: int) -> list[Shown]:
    return [Shown(2 * k + a, name, "", k + 0.1 * a, 10.0) for k in range(turns) for a, name in enumerate(("a", "b"))]


def test_each_agent_shows_its_latest_frame() -> None:
    chosen = steps(_frames(4), 30.0)
    assert [[frame.number for frame in step.values()] for step in chosen] == [[0, 1], [2, 1], [4, 3], [6, 5]]
    assert all(list(step) == ["a", "b"] for step in chosen)


def test_a_clip_ends_after_its_seconds_and_begins_when_all_have_a_frame() -> None:
    assert len(steps(_frames(10), 4.05)) == 5
    late = [
        Shown(0, "a", "", 0.0, 1.0),
        Shown(1, "a", "", 1.0, 1.0),
        Shown(2, "b", "", 1.5, 1.0),
        Shown(3, "a", "", 2.0, 1.0),
    ]
    assert [[frame.number for frame in step.values()] for step in steps(late, 9.0)] == [[1, 2], [3, 2]]

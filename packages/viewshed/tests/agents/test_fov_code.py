"""The code of a view keeps states and the visible cells exactly, and refuses bytes that are no code."""

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed import BevGrid, CellState, FovEstimate, _core
from viewshed.agents.fov_code import decode_fov, encode_fov, has_std, level_values, max_code_bytes


def view_of(grid: BevGrid, prob: Any, state: Any, std: Any = None, threshold: float = 0.5) -> FovEstimate:
    """An estimate of arrays of any type."""
    stds = None if std is None else np.asarray(std, np.float32)
    return FovEstimate(grid, np.asarray(prob, np.float32), np.asarray(state, np.uint8), stds, threshold=threshold)


def street(cells: int = 96, seed: int = 0, threshold: float = 0.5, with_std: bool = False) -> FovEstimate:
    """A view with shadows, a blind spot, noise at its borders, and another share of states on each side."""
    rng, grid = np.random.default_rng(seed), BevGrid(cells, cells / 4, (2.0, -1.0))
    x, y = grid.centers[..., 0], grid.centers[..., 1]
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    noise = 0.1 * rng.normal(size=x.shape) * (np.abs(angle) < 0.8)
    prob = np.clip(1.6 - distance / 14 + noise, 0, 1) * (distance > 2)
    for at in rng.uniform(-np.pi, np.pi, 6):
        prob = np.where((np.abs(angle - at) < 0.1) & (distance > 6), 0.02, prob)
    seen = np.where(distance < 6.5, CellState.SURFACE, CellState.FREE)
    state = np.where(prob >= threshold, seen, np.where(x > 0, CellState.HIDDEN, CellState.UNKNOWN))
    std = np.abs(rng.normal(0, 0.2, x.shape)) * (np.abs(angle - 2) < 0.3) if with_std else None
    return view_of(grid, prob, state, std, threshold)


@st.composite
def estimates(draw: st.DrawFn) -> FovEstimate:
    """Estimates of a few cells, irregular or not, with thresholds and grids of many kinds."""
    cells = draw(st.integers(1, 20))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    grid = BevGrid(cells, 0.3 * cells, (draw(st.floats(-9, 9)), draw(st.floats(-9, 9))))
    shares = rng.dirichlet(np.full(4, draw(st.sampled_from([0.1, 1.0]))))
    prob = np.clip(rng.normal(0.5, draw(st.sampled_from([0.0, 0.2, 5.0])), grid.shape), 0, 1)
    std = draw(st.sampled_from([None, 0.0, 0.1, 5.0]))
    stds = (
        None if std is None else np.where(rng.random(grid.shape) < 0.2, np.nan, np.abs(rng.normal(0, std, grid.shape)))
    )
    threshold = draw(st.sampled_from([1e-3, 0.3, 0.5, 0.9, 1.0]))
    return view_of(grid, prob, rng.choice(4, grid.shape, p=shares), stds, threshold)


def sent(estimate: FovEstimate) -> FovEstimate:
    cells = decode_fov(encode_fov(estimate), estimate.grid, estimate.threshold, has_std(estimate))
    return FovEstimate(
        estimate.grid, cells.visible_prob, cells.state, cells.std, threshold=estimate.threshold, target=estimate.target
    )


@pytest.mark.parametrize("threshold", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("with_std", [False, True])
def test_states_and_mask_are_exact_and_probabilities_within_half_a_level(threshold: float, with_std: bool) -> None:
    estimate = street(threshold=threshold, with_std=with_std)
    found = sent(estimate)
    assert (found.state == estimate.state).all()
    assert (found.visible() == estimate.visible()).all()
    assert np.abs(found.visible_prob - estimate.visible_prob).max() <= max(threshold, 1 - threshold) / 16 + 1e-6
    if with_std:
        assert np.abs(found.std - np.minimum(estimate.std, 0.5)).max() <= 1 / 32 + 1e-6
    else:
        assert np.isnan(found.std).all()


@given(estimates())
def test_any_view_comes_back_with_its_states_and_its_mask(estimate: FovEstimate) -> None:
    with suppress(ValueError):  # noise on a few cells is refused
        found = sent(estimate)
        assert (found.state == estimate.state).all()
        assert (found.visible() == estimate.visible()).all()


def test_noise_falls_back_to_fewer_levels_and_then_is_refused() -> None:
    rng, grid = np.random.default_rng(0), BevGrid(64, 16.0)
    prob = np.where(grid.centers[..., 0] > 4, rng.random(grid.shape), 0.0)
    state = np.where(prob >= 0.5, 1, 3)
    found = sent(view_of(grid, prob, state, rng.random(grid.shape) / 2))
    assert (found.state == state).all()
    assert (found.visible() == (prob >= 0.5)).all()
    assert set(np.unique(found.visible_prob)) <= set(level_values(0.5)[[0, 4, 11, 15]])
    assert np.isnan(found.std).all()
    with pytest.raises(ValueError, match="compress to two bits a cell, got states that look like noise"):
        encode_fov(view_of(grid, rng.random(grid.shape), rng.integers(0, 4, grid.shape)))


def test_a_view_that_takes_too_many_decisions_has_no_code() -> None:
    """Decoding is bounded: noise in all that is coded would take five decisions a cell and more."""
    rng, cells = np.random.default_rng(0), 128
    state, level = (
        rng.integers(0, 4, (cells, cells), dtype=np.uint8),
        rng.integers(0, 16, (cells, cells), dtype=np.uint8),
    )
    assert _core.encode_view(state, level, state[:0, :0].copy(), 64, 64) == b""


@given(st.binary(max_size=200), st.booleans())
def test_rubbish_is_refused(code: bytes, with_std: bool) -> None:
    with pytest.raises(ValueError, match="code of a view"):
        decode_fov(code, BevGrid(32, 16.0), 0.5, with_std)


def test_a_code_cut_off_longer_or_of_another_grid_is_refused() -> None:
    estimate = street()
    code = encode_fov(estimate)
    for bad in (code[:-1], code[: len(code) // 2], b"", code + b"\0", code + b"\1", b"\0" + code):
        with pytest.raises(ValueError, match="damaged, or not of this grid"):
            decode_fov(bad, estimate.grid, 0.5, False)
    for grid in (BevGrid(95, 24.0, (2.0, -1.0)), BevGrid(96, 24.0), BevGrid(128, 24.0, (2.0, -1.0))):
        with pytest.raises(ValueError, match="damaged, or not of this grid"):
            decode_fov(code, grid, 0.5, False)
    with pytest.raises(ValueError, match="damaged"):
        decode_fov(code, estimate.grid, 0.5, True)


def test_damaged_bits_are_refused_or_give_another_valid_view() -> None:
    estimate = street(seed=3)
    code, rng = np.frombuffer(encode_fov(estimate), np.uint8), np.random.default_rng(1)
    refused = 0
    for _ in range(400):
        bad = code.copy()
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        try:
            cells = decode_fov(bad.tobytes(), estimate.grid, 0.5, False)
        except ValueError:
            refused += 1
        else:
            assert cells.state.max() <= 3
    assert refused >= 399


def test_too_many_bytes_and_too_many_cells_are_refused_before_decoding() -> None:
    grid = BevGrid(32, 16.0)
    with pytest.raises(ValueError, match=r"at most 256 bytes, got 257"):
        decode_fov(bytes(257), grid, 0.5, False)
    large = BevGrid(513, 64.0)
    with pytest.raises(ValueError, match="at most 512 cells per side, got 513"):
        decode_fov(b"", large, 0.5, False)
    with pytest.raises(ValueError, match="at most 512 cells per side, got 513"):
        encode_fov(view_of(large, np.zeros(large.shape), np.zeros(large.shape)))
    assert max_code_bytes(BevGrid(1, 1.0)) == 64

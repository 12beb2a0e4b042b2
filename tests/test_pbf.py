"""Position-based fluids."""

import numpy as np
import pytest
import substep


def block(counts, spacing, low=(0.0, 0.0, 0.0)):
    axes = [at + spacing * (np.arange(n) + 0.5) for n, at in zip(counts, low, strict=False)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def dam(n=12, **options):
    """A column of n x n/2 x n particles at the end of a tank."""
    d = 1 / n
    tank = substep.Box((2, 0.25, 1), (4, 0.5, 2), hollow=True, friction=0.0)
    return substep.PositionBasedFluid(block((n, n // 2, n), d), d, colliders=[tank], **options)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_same_bits_for_any_threads_and_through_a_checkpoint(tmp_path, dtype):
    hashes = []
    for threads in (1, 2, 3, 4):
        liquid = dam(threads=threads, dtype=dtype)
        for _ in range(6):
            liquid.step(2e-3)
        liquid.save(tmp_path / "a")
        other = dam(dtype=dtype)
        other.load(tmp_path / "a")
        twin = liquid.copy()
        for sim in (liquid, other, twin):
            for _ in range(6):
                sim.step(2e-3)
            hashes.append(substep.state_hash(*sim.state().values()))
    assert len(set(hashes)) == 1

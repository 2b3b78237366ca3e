"""The numbers of every scheme, of a campaign and of a tune are those that were kept, to rounding."""

import numpy as np
import pytest

from tests.golden import runs


@pytest.fixture(scope="module")
def kept():
    with np.load(runs.FILE) as file:
        return dict(file)


def assert_as_kept(kept, part, found):
    assert {f"{part}/{name}" for name in found} == {name for name in kept if name.startswith(f"{part}/")}
    for name, value in found.items():
        wanted = kept[f"{part}/{name}"]
        if wanted.dtype.kind not in "fiub":
            np.testing.assert_array_equal(value, wanted, err_msg=name)
            continue
        size = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0) if wanted.dtype.kind == "f" else 0.0
        np.testing.assert_allclose(value, wanted, rtol=1e-7, atol=1e-8 * size, err_msg=f"{part}/{name}")


@pytest.mark.parametrize("name", runs.SCHEMES)
def test_the_run_of_a_scheme(kept, name):
    assert_as_kept(kept, f"traces.{name}", runs.traces(name))


def test_the_rows_of_a_campaign(kept):
    assert_as_kept(kept, "rows", runs.rows())


@pytest.mark.slow
def test_the_gains_of_a_tune(kept):
    assert_as_kept(kept, "tuned", runs.tuned())

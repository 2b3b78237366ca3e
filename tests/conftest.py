"""JAX in double precision, a persistent compilation cache, hypothesis without chance, and few passes of the collector."""

import gc

import hypothesis
import jax
import pytest

import jaxftc
from jaxftc.cli.common import MANY_OBJECTS
from tests.arms import two_hinges

jax.config.update("jax_enable_x64", True)  # float32 tests say so with jax.enable_x64(False)

hypothesis.settings.register_profile("deterministic", derandomize=True, deadline=None, database=None, max_examples=50)
hypothesis.settings.load_profile("deterministic")

gc.set_threshold(*MANY_OBJECTS)  # as the commands do


def pytest_configure(config):
    """Compiled programs are kept in pytest's cache folder, so that only the first run compiles."""
    if hasattr(config, "cache"):
        jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("jax-compilations")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    # A worker that meets an entry which another one is still writing compiles it itself.
    config.addinivalue_line("filterwarnings", "ignore:Error (reading|writing) persistent compilation cache:UserWarning")


@pytest.fixture(scope="session")
def puma() -> jaxftc.Robot:
    """The built-in arm, dry friction included."""
    return jaxftc.puma560()


@pytest.fixture(scope="session")
def paper_arm() -> jaxftc.Robot:
    """The arm of the paper's conditions: viscous friction only."""
    return jaxftc.puma560(coulomb=False)


@pytest.fixture(scope="session")
def puma_config(paper_arm) -> jaxftc.Config:
    """The same as ``config`` on six joints, for what depends on them."""
    return jaxftc.Config(paper_arm, engine="chain", duration=0.06)


@pytest.fixture(scope="session")
def config() -> jaxftc.Config:
    """Every stage of the cascade and the adaptive law, on the quick engine, for 60 ticks of two joints."""
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.06)

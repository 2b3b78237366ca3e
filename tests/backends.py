"""The backends of a tick, and the mark of a test that needs a C compiler: a machine need not have one."""

import pytest

from jaxftc.compile import native

needs_c = pytest.mark.skipif(native.compiler() is None, reason="no C compiler on this machine")
BACKENDS = ["xla", pytest.param("c", marks=needs_c)]

"""OpenGL for tests that draw pictures."""

from __future__ import annotations

import pytest

from iits_mj.core.errors import RenderError
from iits_mj.render.context import make_context


@pytest.fixture(scope="session")
def opengl() -> None:
    """Skips the tests that use it where OpenGL is missing."""
    try:
        make_context(16, 16).free()
    except RenderError as error:
        pytest.skip(f"OpenGL is missing: {error}")

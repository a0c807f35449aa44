"""One process of ``prosim watch`` for the tests of a module."""

import pytest
from little import LITTLE, watching


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("watched") / "little.scn"
    path.write_text(LITTLE)
    return path


@pytest.fixture(scope="module")
def address(scene):
    with watching(scene) as (_, address):
        yield address

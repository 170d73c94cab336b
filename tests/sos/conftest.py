"""Fixtures of the tests of `aerotube.sos`."""

import pytest

from tests.sos.programs import tube_program


@pytest.fixture(scope="session")
def tube():
    return tube_program()

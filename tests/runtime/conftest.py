"""One scenario for the runtime's tests: twelve beats of Table 2, in windows of six."""

import pytest

from aerotube.preparation import prepare
from aerotube.scenario import load


@pytest.fixture(scope="session")
def prepared():
    return prepare(load(None, {"nominal.horizon": "0.6 s"}))

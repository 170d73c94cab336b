"""Where a nominal trajectory comes from: constant controls, trim, or a file."""

from aerotube.nominal.files import read, write
from aerotube.nominal.trajectory import Nominal, constant_controls, from_trim

__all__ = ["Nominal", "constant_controls", "from_trim", "read", "write"]

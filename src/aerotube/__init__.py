"""aerotube: trajectory tubes and compensation laws for aircraft, by sum-of-squares programming."""

__version__ = "0.1.0"

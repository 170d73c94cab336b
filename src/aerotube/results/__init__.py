"""Results: labelled datasets with schema version and provenance, written whole or not at all."""

from aerotube.results.dataset import SCHEMA_VERSION, build, read, write
from aerotube.results.provenance import provenance
from aerotube.results.record import (
    CALM,
    CONDITION_WORDS,
    CONTROLLER_WORDS,
    CONTROLLERS,
    ESTIMATOR,
    KEY_SUFFIX,
    NOISE,
    SETTING,
    Case,
    Law,
    Record,
)
from aerotube.results.summary import mean_upper_error, summarise
from aerotube.results.writing import ensure_folder, out_folder, whole_file, write_json, write_text

__all__ = [
    "CALM",
    "CONDITION_WORDS",
    "CONTROLLERS",
    "CONTROLLER_WORDS",
    "ESTIMATOR",
    "KEY_SUFFIX",
    "NOISE",
    "SCHEMA_VERSION",
    "SETTING",
    "Case",
    "Law",
    "Record",
    "build",
    "ensure_folder",
    "mean_upper_error",
    "out_folder",
    "provenance",
    "read",
    "summarise",
    "whole_file",
    "write",
    "write_json",
    "write_text",
]

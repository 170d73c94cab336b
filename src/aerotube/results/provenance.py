"""Where numbers come from: versions, platform, date, scenario."""

from __future__ import annotations

import datetime
import json
import platform
from importlib import metadata

from aerotube import __version__
from aerotube.scenario import Source

_LIBRARIES = ("numpy", "scipy", "numba", "clarabel", "pydantic", "xarray", "h5netcdf", "matplotlib", "plotly")


def provenance(source: Source) -> dict[str, str]:
    """Describe where a result comes from.

    Parameters
    ----------
    source : Source
        The scenario with its text.

    Returns
    -------
    dict of str
        Ready to be the attributes of a dataset.
    """
    # Some are optional, and absent where they are not needed.
    installed = {distribution.name for distribution in metadata.distributions()}
    libraries = {name: metadata.version(name) for name in _LIBRARIES if name in installed}
    return {
        "aerotube_version": __version__,
        "scenario_title": source.scenario.title,
        "scenario_name": source.name,
        "scenario_text": source.text,
        "scenario_sha256": source.sha256,
        "scenario_overrides": json.dumps(source.overrides, ensure_ascii=False),
        "scenario_si": source.scenario.model_dump_json(),
        "python_version": platform.python_version(),
        "library_versions": json.dumps(libraries),
        "platform": platform.platform(),
        "processor": _processor(),
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    except OSError:  # not Linux
        names = []
    return f"{len(names)} x {names[0]}" if names else platform.processor() or platform.machine()

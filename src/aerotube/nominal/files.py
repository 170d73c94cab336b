"""Nominal trajectories in files: CSV for spreadsheets, netCDF for everything else.

A CSV file has one header line with the columns ``time`` (s), the aircraft's state names and its control names,
in any order, SI and radians, and one row a sample. The controls of the last row are not flown. A netCDF file has
a dimension ``time`` and a variable of one dimension for each of the same names.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np

from aerotube.aircraft.base import Aircraft
from aerotube.errors import InputError
from aerotube.nominal.trajectory import Array, Nominal


def read(path: str | Path, aircraft: Aircraft) -> Nominal:
    """Read a nominal trajectory from a CSV or netCDF file.

    Parameters
    ----------
    path : path
        Ends in ``.csv``, ``.nc`` or ``.nc4``.
    aircraft : Aircraft
        Whose state and control names the file uses.

    Returns
    -------
    Nominal

    Raises
    ------
    InputError
        If the file is missing or unreadable, lacks a column, or its times are not uniform.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"nominal: there is no file {path}; check the name.")
    if path.suffix == ".csv":
        columns = _read_csv(path)
    elif path.suffix in (".nc", ".nc4"):
        columns = _read_netcdf(path)
    else:
        raise InputError(f"nominal: {path.name} is neither .csv nor .nc; convert it to one of them.")
    units = _units(aircraft)
    missing = [name for name in units if name not in columns]
    if missing:
        told = "all" if len(missing) == len(units) else ", ".join(missing)
        needed = ", ".join(f"{name} ({unit})" for name, unit in units.items())
        raise InputError(f"nominal: {path.name} lacks columns: {told}; it needs, in any order, {needed}.")
    time = columns["time"]
    if len(time) < 2:
        raise InputError(f"nominal: {path.name} holds {len(time)} sample(s); at least two are needed.")
    dt = float(time[-1] - time[0]) / (len(time) - 1)
    if not (dt > 0 and np.allclose(np.diff(time), dt, rtol=1e-6, atol=1e-9)):
        raise InputError(f"nominal: the times in {path.name} are not evenly spaced; resample them.")
    states = np.stack([columns[name] for name in aircraft.state_names], axis=-1)
    controls = np.stack([columns[name] for name in aircraft.control_names], axis=-1)[:-1]
    norm = np.linalg.norm(states[:, 3:7], axis=-1)
    if not np.all(np.abs(norm - 1) < 1e-3):
        row = int(np.argmax(~(np.abs(norm - 1) < 1e-3)))
        raise InputError(
            f"nominal: the quaternion in row {row} of {path.name} has length {norm[row]:.6g}; it must be 1."
        )
    states[:, 3:7] /= norm[:, None]
    return Nominal(dt, states, controls, f"file {path.name}")


def write(path: str | Path, nominal: Nominal, aircraft: Aircraft) -> None:
    """Write a nominal trajectory to a CSV or netCDF file that :func:`read` reads back.

    The file is written aside and renamed, so that it is there whole or not at all.

    Raises
    ------
    InputError
        For any other kind of file.
    """
    path = Path(path)
    controls = np.concatenate([nominal.controls, nominal.controls[-1:]])
    columns = {"time": nominal.times}
    columns |= {name: nominal.states[:, i] for i, name in enumerate(aircraft.state_names)}
    columns |= {name: controls[:, i] for i, name in enumerate(aircraft.control_names)}
    units = _units(aircraft)
    aside = path.with_name(path.name + ".part")
    if path.suffix == ".csv":
        with open(aside, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(map(repr, map(float, column)) for column in columns.values()), strict=True))
    elif path.suffix in (".nc", ".nc4"):
        import xarray as xr

        data = {name: ("time", column, {"units": units[name]}) for name, column in columns.items() if name != "time"}
        dataset = xr.Dataset(data, {"time": ("time", columns["time"], {"units": "s"})}, {"source": nominal.source})
        dataset.to_netcdf(aside, engine="h5netcdf")
    else:
        raise InputError(f"nominal: {path.name} is neither .csv nor .nc; choose one of them.")
    os.replace(aside, path)


def _units(aircraft: Aircraft) -> dict[str, str]:
    """The columns of a file with their units."""
    names = ("time", *aircraft.state_names, *aircraft.control_names)
    return dict(zip(names, ("s", *aircraft.state_units, *aircraft.control_units), strict=True))


def _read_csv(path: Path) -> dict[str, Array]:
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    if not rows:
        raise InputError(f"nominal: {path.name} is empty.")
    header = [name.strip() for name in rows[0]]
    table = np.empty((len(rows) - 1, len(header)))
    for number, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise InputError(
                f"nominal: row {number} of {path.name} has {len(row)} values under {len(header)} names; mend it."
            )
        try:
            table[number] = [float(value) for value in row]
        except ValueError:
            raise InputError(f"nominal: row {number} of {path.name} holds something that is no number.") from None
    return {name: table[:, i] for i, name in enumerate(header)}


def _read_netcdf(path: Path) -> dict[str, Array]:
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
            dataset.load()
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "it is of another format"
        raise InputError(f"nominal: {path.name} cannot be read as netCDF ({why}); write it anew.") from None
    return {
        str(name): np.asarray(variable.values, dtype=float)
        for name, variable in dataset.variables.items()
        if variable.dims == ("time",)
    }

"""Plain numerical tools that know no aircraft: tables, attitude, Taylor arithmetic, intervals, Taylor models."""

from aerotube.numerics import model_functions  # noqa: F401 - what NumPy does with Taylor models
from aerotube.numerics.attitude import (
    body_to_earth,
    earth_to_body,
    euler_from_quaternion,
    normalise,
    quaternion_conjugate,
    quaternion_from_euler,
    quaternion_product,
    quaternion_rates,
    wrap_angle,
)
from aerotube.numerics.borrowed import borrowed
from aerotube.numerics.interval import Interval
from aerotube.numerics.lookup import entry, lookup1, lookup2
from aerotube.numerics.select import select
from aerotube.numerics.tables import Table1, Table2, stack1, stack2, table1, table2
from aerotube.numerics.taylor import Taylor, TaylorSpace
from aerotube.numerics.taylor_model import ModelSpace, TaylorModel

__all__ = [
    "Interval",
    "ModelSpace",
    "Table1",
    "Table2",
    "Taylor",
    "TaylorModel",
    "TaylorSpace",
    "body_to_earth",
    "borrowed",
    "earth_to_body",
    "entry",
    "euler_from_quaternion",
    "lookup1",
    "lookup2",
    "normalise",
    "quaternion_conjugate",
    "quaternion_from_euler",
    "quaternion_product",
    "quaternion_rates",
    "select",
    "stack1",
    "stack2",
    "table1",
    "table2",
    "wrap_angle",
]

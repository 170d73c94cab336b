"""Plain numerical tools that know no aircraft: tables, attitude, Taylor arithmetic."""

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
from aerotube.numerics.select import select
from aerotube.numerics.tables import Table1, Table2, lookup1, lookup2, stack1, stack2, table1, table2

__all__ = [
    "Table1",
    "Table2",
    "body_to_earth",
    "earth_to_body",
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

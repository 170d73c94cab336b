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
from aerotube.numerics.lookup import lookup1, lookup2
from aerotube.numerics.select import select
from aerotube.numerics.tables import Table1, Table2, stack1, stack2, table1, table2
from aerotube.numerics.taylor import Taylor, TaylorSpace

__all__ = [
    "Table1",
    "Table2",
    "Taylor",
    "TaylorSpace",
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

"""Parametric sum-of-squares programs: structure compiled once, data per solve, batches, checked answers.

program = sos.Program()
rho = program.scalar("rho")
program.sos("bound", sos.Sphere(3), degree=4)
structure = program.compile()
f = ...  # values of a polynomial of degree 4 at structure.nodes("bound")
data = structure.data(objective=[1.0], constraints={"bound": (-f, np.ones((len(f), 1)))})
solution = sos.solve(structure, data)  # the largest value of f on the sphere, from above
"""

from aerotube.sos.basis import Polynomial
from aerotube.sos.certificate import Certificate
from aerotube.sos.check import check_file
from aerotube.sos.domain import Ball, Domain, Interval, Product, Sphere
from aerotube.sos.program import Constraint, Data, Program, Structure, Variable
from aerotube.sos.solution import Solution, Status
from aerotube.sos.solve import check_backend, solve

__all__ = [
    "Ball",
    "Certificate",
    "Constraint",
    "Data",
    "Domain",
    "Interval",
    "Polynomial",
    "Product",
    "Program",
    "Solution",
    "Sphere",
    "Status",
    "Structure",
    "Variable",
    "check_backend",
    "check_file",
    "solve",
]

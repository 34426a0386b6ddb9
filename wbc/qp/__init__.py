"""Quadratic programs: one problem form, persistent solvers behind it. The only place that names a solver."""

from wbc.qp.daqp_solver import DaqpSolver
from wbc.qp.problem import FEASIBILITY_TOLERANCE, UNBOUNDED, QpSolution, QpSolver, QpStatus, kkt_residual
from wbc.qp.proxqp_solver import ProxqpSolver
from wbc.qp.solvers import make_solver

__all__ = [
    "FEASIBILITY_TOLERANCE",
    "UNBOUNDED",
    "DaqpSolver",
    "ProxqpSolver",
    "QpSolution",
    "QpSolver",
    "QpStatus",
    "kkt_residual",
    "make_solver",
]

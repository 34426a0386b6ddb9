"""Solvers by name."""

from robots.checks import require_one_of
from robots.errors import ConfigError
from robots.messages import Array
from wbc.qp.daqp_solver import DaqpSolver
from wbc.qp.problem import QpSolver
from wbc.qp.proxqp_solver import ProxqpSolver


def make_solver(name: str, n: int, m: int, slack_weights: Array | None = None) -> QpSolver:
    r"""A persistent solver for ``n`` variables and ``m`` rows.

    Args:
        name: ``daqp`` (dual active set) or ``proxqp`` (augmented Lagrangian).
        n: number of variables.
        m: number of rows.
        slack_weights: shape (m,), above 0: row i may be violated by :math:`s_i` at the cost
            :math:`\tfrac12 w_i s_i^2`; infinite for a row that must hold. Only ``daqp`` has them.

    Raises:
        ConfigError: unknown name, a weight that is not above 0, or weights for a solver that has none.
    """
    require_one_of("qp solver", name, ("daqp", "proxqp"))
    if slack_weights is None:
        return DaqpSolver(n, m) if name == "daqp" else ProxqpSolver(n, m)
    if name != "daqp":
        raise ConfigError("qp solver", name, "daqp where rows may be violated")
    if slack_weights.shape != (m,) or not (slack_weights > 0).all():
        raise ConfigError("slack_weights", slack_weights, f"{m} numbers above 0")
    return DaqpSolver(n, m, slack_weights)

"""Whether the arrays that a filter is given fit together, and are numbers to reckon with."""

from robots.checks import all_finite
from robots.messages import Array
from safety.barriers.rows import BarrierRows
from safety.geometry.contact_rows import all_numbers

JACOBIANS = ("feet", "balance", "hands")


def wrong_shape(
    n: int, nv: int, rows: BarrierRows, nominal: Array, velocity: Array | None, jacobians: tuple[Array | None, ...]
) -> str:
    """What does not have the shape that it should have, in words; empty where all do.

    Numpy would stretch an array with one entry over all rows.

    Args:
        n: number of barrier rows.
        nv: number of inputs.
        rows: each array is looked at, ``curvature`` where there is one.
        nominal: input, should be of shape (nv,).
        velocity: likewise, the measured one; ``None`` is left out.
        jacobians: of ``JACOBIANS``, should be of shape (k, nv), whatever k; ``None`` is left out.
    """
    if rows.jac.shape != (n, nv):
        return _words("jac of the barrier rows", rows.jac, f"({n}, {nv})")
    line, vector = (n,), (nv,)
    if not rows.h.shape == rows.dh_dt.shape == rows.family.shape == line or _differs(rows.curvature, line):
        for name in ("h", "dh_dt", "family", "curvature"):
            if _differs(array := getattr(rows, name), line):
                return _words(f"{name} of the barrier rows", array, f"({n},)")
    if nominal.shape != vector:
        return _words("nominal input", nominal, f"({nv},)")
    if velocity is not None and velocity.shape != vector:
        return _words("measured velocity", velocity, f"({nv},)")
    for name, array in zip(JACOBIANS, jacobians, strict=True):
        if array is not None and (array.ndim != 2 or array.shape[1] != nv):
            return _words(f"Jacobian of the {name}", array, f"(any number, {nv})")
    return ""


def not_finite(order: int, rows: BarrierRows, nominal: Array, velocity: Array | None) -> str:
    """Which inputs of a filter have a number that is not finite or, for order 2, are missing, in words; empty for none.

    Args:
        order: 1, the nominal input is a velocity; 2, it is an acceleration.
        rows: curvature is looked at for order 2.
        nominal: shape (nv,).
        velocity: shape (nv,), measured, for order 2.
    """
    if not all_finite(nominal):
        return f"nominal {'velocity' if order == 1 else 'acceleration'} is not finite"
    if not all_numbers(rows.h, rows.dh_dt, rows.jac):
        return "barrier rows are not finite"
    if order == 1:
        return ""
    if velocity is None or not all_finite(velocity):
        return "measured velocity is missing or not finite"
    if rows.curvature is None or not all_finite(rows.curvature):
        return "curvature of the barrier rows is missing or not finite"
    return ""


def wrong_epsilon(n: int, epsilon: Array | None) -> str:
    """Why these cannot be the ISSf parameters of ``n`` rows, in words; empty where they can, or there are none."""
    if epsilon is None:
        return ""
    if epsilon.shape != (n,):
        return f"epsilon has shape {epsilon.shape}, expected {(n,)}"
    return "" if all_finite(epsilon) and (epsilon > 0).all() else "epsilon is not finite and above 0 throughout"


def _differs(array: Array | None, shape: tuple[int, ...]) -> bool:
    return array is not None and array.shape != shape


def _words(name: str, array: Array, expected: str) -> str:
    return f"{name} has shape {array.shape}, expected {expected}"

"""Which strategy a configuration asks for."""

from controllers.whole_body.acceleration_filter import AccelerationFilter
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.strategy import SafetyStrategy
from controllers.whole_body.velocity_filter import VelocityFilter
from robots.messages import Array
from safety.filters.registry import filter_kind
from wbc.dynwbc import DynWbc


def make_strategy(config: ControllerConfig, n_rows: int, joint_limits: Array, dynwbc: DynWbc) -> SafetyStrategy:
    """The strategy of a configuration's filter.

    Args:
        config: of the controller.
        n_rows: number of barrier rows.
        joint_limits: shape (nj,) velocity limits of the joints [rad/s].
        dynwbc: that conditions on the acceleration are for.
    """
    kind = filter_kind(config.filter)
    if kind.acts_in_dynamics:
        return AccelerationFilter(kind, config.safety, n_rows, joint_limits, dynwbc, config.dt)
    return VelocityFilter(config, n_rows, joint_limits)

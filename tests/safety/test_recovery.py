"""The way out of a broken barrier: bounded in speed and acceleration, and rows that hold may not fall meanwhile."""

from dataclasses import replace

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import BarrierParameters, FamilyParameters, cbf
from safety.filters.recovery import Recovery, RecoverySettings
from safety.filters.safety_filter import FilterResult, FilterSettings, FilterStatus, SafetyFilter

DT, ALPHA, DEPTH, SPEED, ACCELERATION = 0.002, 4.0, 0.005, 0.25, 2.0
SETTINGS = RecoverySettings()
FAMILY = FamilyParameters(
    alpha=ALPHA,
    recovery_depth=DEPTH,
    recovery_speed=SPEED,
    recovery_acceleration=ACCELERATION,
    layer=0.005,
    eta=0.1,
    slack_weight=1e5,
)
PARAMETERS = BarrierParameters(**dict.fromkeys(FAMILIES, FAMILY))
QPS = ("cbf", "issf", "ssa", "rssa", "pssa", "sss")


def rows_of(h: Array, jac: Array, dh_dt: Array | None = None) -> BarrierRows:
    n = len(h)
    return BarrierRows(
        np.array(h, dtype=float), jac, np.zeros(n) if dh_dt is None else dh_dt, np.ones(n, dtype=np.intp)
    )


def filter_of(n: int, nv: int, name: str = "cbf", recovery: RecoverySettings | None = SETTINGS) -> SafetyFilter:
    return SafetyFilter(name, n, PARAMETERS, np.full(nv, 20.0), settings=FilterSettings(dt=DT, recovery=recovery))


def leave(safety: SafetyFilter, h: Array, jac: Array, v_des: Array, duration: float) -> tuple[Array, Array]:
    """Rows of constant gradient, moved exactly as the filter says: h (steps + 1, n) and v (steps, nv)."""
    heights, velocities = [np.array(h, dtype=float)], []
    for _ in range(round(duration / DT)):
        result = safety.apply(rows_of(heights[-1], jac), v_des)
        assert result.status != FilterStatus.FAILED
        velocities.append(result.v)
        heights.append(heights[-1] + DT * (jac @ result.v))
    return np.array(heights), np.array(velocities)


@pytest.mark.parametrize("name", QPS)
@pytest.mark.parametrize("pull", [0.0, -1.5])
def test_a_row_comes_back_in_the_time_that_is_guaranteed(name: str, pull: float) -> None:
    jac, start = np.array([[0.3, -0.4, 0.0]]), -0.1
    h, v = leave(filter_of(1, 3, name), np.array([start]), jac, pull * jac[0] / np.linalg.norm(jac), 2.0)
    u, k = SETTINGS.acceleration, SETTINGS.weight
    fall = u * np.abs(jac).sum()
    assert fall < k * ACCELERATION
    speed = SPEED - fall * DT / k
    guaranteed = -start / speed + SPEED * (k + 1) / (k * ACCELERATION - fall)
    deep = h[:, 0] < -DEPTH
    assert deep.argmin() * DT <= guaranteed
    # from there on exponentially
    first = int(deep.argmin())
    times = DT * np.arange(len(h) - first)
    decay = np.exp(-(1 - 1 / k) * speed / DEPTH * times)
    assert (h[first:, 0] >= -DEPTH * decay - 1e-4).all()
    # no faster than what it may ask for, which grows no faster than it may
    rate = v @ jac[0]
    fastest = {"cbf": 0.0, "issf": 0.25 / FAMILY.epsilon, "sss": 10 * 0.01}.get(name, 0.1) + SPEED
    assert rate.max() <= fastest + 1e-6
    assert np.diff(rate, prepend=0.0).max() <= ACCELERATION * DT + fall * DT + 1e-6


def contradicting(n: int = 6, nv: int = 5) -> Array:
    """Rows that hold together only at a great velocity."""
    rng = np.random.default_rng(4)
    jac = np.zeros((n, nv))
    jac[:, 0] = np.where(np.arange(n) % 2, -0.4, 0.4)
    jac[:, 1:] = 0.01 + 0.002 * rng.normal(size=(n, nv - 1))
    return jac


@pytest.mark.parametrize("name", QPS)
def test_rows_that_contradict_each_other_are_left_gently(name: str) -> None:
    jac = contradicting()
    h, v = leave(filter_of(6, 5, name), np.full(6, -0.1), jac, np.zeros(5), 1.0)
    strict = filter_of(6, 5, name, None).apply(rows_of(h[0], jac), np.zeros(5)).v
    steps = np.abs(np.diff(v, axis=0, prepend=np.zeros((1, 5))))
    # the bound that is stated, unit metric; the largest entry is no larger than the length
    length = np.linalg.norm(jac, axis=1)
    bound = np.sqrt(SETTINGS.weight * np.sum((ACCELERATION * DT / length) ** 2))
    bound += 2 * SETTINGS.acceleration * DT * np.sqrt(5)
    assert np.linalg.norm(steps, axis=1).max() <= bound
    assert np.abs(strict).max() > 4 * steps.max()
    # what they have in common is had
    assert (h[-1] > h[0]).all()


def test_rows_that_hold_are_kept_and_go_before_those_that_do_not() -> None:
    """The lost row wants what the other forbids."""
    jac = np.array([[0.5, 0.0], [-0.5, 0.0]])
    safety = filter_of(2, 2)
    h = np.array([-0.1, 0.01])
    for _ in range(500):
        result = safety.apply(rows_of(h, jac), np.zeros(2))
        assert (jac @ result.v)[1] >= -ALPHA * h[1] - 1e-8
        # what is not met is said, against the condition as it is
        assert result.status == FilterStatus.RELAXED
        assert result.relaxed.tolist() == [0]
        assert result.slack == pytest.approx(-ALPHA * h[0] - (jac @ result.v)[0], abs=1e-9)
        h = h + DT * (jac @ result.v)
    assert 0 < h[1] < 0.001


@pytest.mark.parametrize("seed", range(5))
def test_only_what_lost_rows_ask_for_changes_and_continuously(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, nv = 30, 8
    jac, dh_dt = rng.normal(size=(n, nv)), 0.1 * rng.normal(size=n)
    h = rng.uniform(-0.02, 0.05, size=n)
    h[0], h[1], h[2] = -0.1, -1e-9, 0.0
    p = PARAMETERS.of_rows(np.ones(n, dtype=np.intp))
    recovery = Recovery(nv, n, SETTINGS, DT)
    rows = rows_of(h, jac, dh_dt)
    spaces = cbf(rows, p)
    b, A = spaces.b.copy(), spaces.A.copy()
    eased = recovery.ease(rows, spaces, cbf, p, np.zeros(nv), lambda: np.eye(nv), np.full(nv, 20.0))
    assert eased is not None
    np.testing.assert_array_equal(spaces.b, b)
    np.testing.assert_array_equal(eased.spaces.A, A)
    np.testing.assert_array_equal(eased.spaces.b[h >= 0], b[h >= 0])
    assert eased.spaces.b[1] == pytest.approx(b[1], abs=1e-5)
    lost = h < 0
    assert (eased.spaces.b[lost] + dh_dt[lost] <= SPEED + 1e-9).all()


@pytest.mark.parametrize("name", QPS)
def test_a_row_that_is_met_all_along_is_not_eased_however_deep(name: str) -> None:
    """A disturbance carries h below the boundary while the command does what is asked: the filter stays as it is."""
    jac = np.array([[0.5, 0.2]])
    with_it, without = filter_of(1, 2, name), filter_of(1, 2, name, None)
    for h in np.linspace(0.02, -0.02, 400):
        results: list[FilterResult] = [
            f.apply(rows_of(np.array([h]), jac), np.array([-0.2, 0.1])) for f in (with_it, without)
        ]
        np.testing.assert_array_equal(results[0].v, results[1].v)


def test_once_out_the_filter_is_the_strict_one_again() -> None:
    jac, v_des = np.array([[0.3, -0.4, 0.0], [0.0, 0.5, 0.1]]), np.array([-0.3, 0.2, 1.0])
    safety, strict = filter_of(2, 3), filter_of(2, 3, recovery=None)
    h, v = leave(safety, np.array([-0.1, 0.05]), jac, v_des, 6.0)
    assert (h[-1] >= -1e-5).all()
    rows = rows_of(np.array([0.001, 0.05]), jac)
    np.testing.assert_allclose(safety.apply(rows, v_des).v, strict.apply(rows, v_des).v, rtol=0, atol=1e-6)
    assert np.abs(np.diff(v, axis=0)).max() < 0.15


def test_what_moves_elsewhere_is_not_held_back() -> None:
    """The nominal velocity of joints that no lost row has: passed at once."""
    jac = np.array([[0.5, 0.0, 0.0]])
    safety = filter_of(1, 3)
    for k in range(100):
        v_des = np.array([0.0, np.sin(0.5 * k), 3.0 * np.cos(0.7 * k)])
        result = safety.apply(rows_of(np.array([-0.1]), jac), v_des)
        np.testing.assert_allclose(result.v[1:], v_des[1:], rtol=0, atol=1e-9)


def test_pushes_and_accelerations_have_none() -> None:
    for name in ("pfm", "sma"):
        rows = rows_of(np.array([-0.1]), np.array([[0.5, 0.1]]))
        rows = replace(rows, cartesian=lambda _: (np.array([[0.5, 0.1]]), np.ones(1)))
        results = [filter_of(1, 2, name, r).apply(rows, np.zeros(2)) for r in (None, SETTINGS)]
        np.testing.assert_array_equal(results[0].v, results[1].v)


@pytest.mark.parametrize("jac", [1e200, 1e-200, 0.0])
@pytest.mark.parametrize("h", [-1e200, -1e-3, -0.1])
def test_numbers_that_are_too_large_or_vanish_do_not_raise(jac: float, h: float) -> None:
    safety = filter_of(3, 2)
    rows = rows_of(np.array([h, -0.1, 0.1]), np.array([[jac, 0.0], [0.3, 0.4], [0.0, jac]]))
    for _ in range(3):
        result = safety.apply(rows, np.zeros(2), hands=np.array([[jac, 1.0]]))
        assert np.isfinite(result.v).all()


@pytest.mark.parametrize("name", ["weight", "acceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"recovery {name}"):
        RecoverySettings(**{name: value})


def test_the_end_of_a_recovery_does_not_jump() -> None:
    """A row on its boundary asks to come away from it, and has not got that when the lost row is out, at once."""
    jac, last = np.array([[0.5, 0.0], [0.0, 0.3]]), np.zeros(2)
    safety = filter_of(2, 2, "issf")
    for k in range(400):
        result = safety.apply(rows_of(np.array([0.0, -0.06 if k < 5 else 0.001]), jac), np.zeros(2))
        assert np.abs(result.v - last).max() < 0.05
        last = result.v
    # in the end all that is asked for is given
    assert result.status == FilterStatus.FILTERED
    assert jac[0] @ last == pytest.approx(0.25 / FAMILY.epsilon, abs=1e-6)


def test_what_was_changed_before_a_recovery_is_not_carried_into_it() -> None:
    """An obstacle asks for a great velocity for one tick and is gone; then another row is found deep inside."""
    jac = np.array([[0.01, 0.0, 0.0], [0.0, 1.0, 0.0]])
    safety = filter_of(2, 3)
    before = safety.apply(rows_of(np.array([0.001, 0.05]), jac, np.array([-0.15, 0.0])), np.zeros(3))
    assert before.v[0] > 10.0
    for _ in range(10):
        result = safety.apply(rows_of(np.array([0.5, -0.06]), jac), np.zeros(3))
        assert result.v[0] == pytest.approx(0.0, abs=1e-9)


def test_little_of_a_correction_is_carried_on() -> None:
    """While a row is lost a holding one asks for a great velocity in one tick; the next one keeps 3 rad/s at most."""
    jac = np.array([[0.01, 0.0, 0.0], [0.0, 1.0, 0.0]])
    safety = filter_of(2, 3)
    for _ in range(3):
        safety.apply(rows_of(np.array([0.5, -0.06]), jac), np.zeros(3))
    pushed = safety.apply(rows_of(np.array([0.001, -0.06]), jac, np.array([-0.15, 0.0])), np.zeros(3))
    assert pushed.v[0] > 10.0
    assert safety.apply(rows_of(np.array([0.5, -0.06]), jac), np.zeros(3)).v[0] <= 3.0


@pytest.mark.parametrize("name", ["cbf", "sss"])
def test_rows_that_hold_go_first_however_many_are_lost(name: str) -> None:
    """More lost rows than twice the number of variables: what a holding row needs not to fall is kept all the same."""
    rng = np.random.default_rng(7)
    n, nv = 40, 4
    safety = filter_of(n, nv, name)
    jac = rng.normal(size=(n, nv))
    h = np.append(0.001, rng.uniform(-0.05, -0.01, n - 1))
    dh_dt = np.append(-0.1, np.zeros(n - 1))
    for _ in range(20):
        result = safety.apply(rows_of(h, jac, dh_dt), rng.normal(size=nv))
        # a CBF may let it sink towards its boundary, SSS not below its margin
        assert jac[0] @ result.v + dh_dt[0] >= (-ALPHA * h[0] if name == "cbf" else 0.0) - 1e-6


@pytest.mark.parametrize("depth", [0.4, 0.9])
def test_shallow_rows_are_not_eased_however_suddenly_they_ask(depth: float) -> None:
    jac = np.array([[0.3, -0.4]])
    rows = rows_of(np.array([-depth * DEPTH]), jac, np.array([-0.5]))
    eased, strict = (filter_of(1, 2, recovery=r).apply(rows, np.zeros(2)) for r in (SETTINGS, None))
    np.testing.assert_array_equal(eased.v, strict.v)


def test_after_a_reset_the_robot_is_at_rest_and_no_row_was_lost() -> None:
    jac, deep = np.array([[0.3, -0.4]]), np.array([-0.1])
    used, fresh = filter_of(1, 2), filter_of(1, 2)
    for _ in range(50):
        used.apply(rows_of(deep, jac), np.ones(2))
    used.reset()
    np.testing.assert_allclose(
        used.apply(rows_of(deep, jac), np.zeros(2)).v, fresh.apply(rows_of(deep, jac), np.zeros(2)).v, rtol=0, atol=1e-9
    )


def test_input_that_is_refused_leaves_no_command_to_go_on_from() -> None:
    jac, deep = np.array([[0.3, -0.4]]), np.array([-0.1])
    used, fresh = filter_of(1, 2), filter_of(1, 2)
    for _ in range(50):
        used.apply(rows_of(deep, jac), np.zeros(2))
    assert used.apply(rows_of(deep, jac), np.full(2, np.nan)).status == FilterStatus.FAILED
    np.testing.assert_allclose(
        used.apply(rows_of(deep, jac), np.zeros(2)).v, fresh.apply(rows_of(deep, jac), np.zeros(2)).v, rtol=0, atol=1e-9
    )


def test_the_papers_baseline_is_not_eased() -> None:
    """Where the nominal velocity is passed on, it is that, not one near the last command."""
    settings = FilterSettings("unsafe_pass_nominal", dt=DT, recovery=SETTINGS)
    safety = SafetyFilter("cbf", 2, PARAMETERS, np.full(2, 20.0), settings=settings)
    nominal, jac = np.array([0.3, -0.5]), np.array([[1.0, 0.0], [-1.0, 0.0]])
    for _ in range(3):
        result = safety.apply(rows_of(np.array([-0.1, -0.1]), jac), nominal)
        assert result.status == FilterStatus.UNSAFE
        np.testing.assert_array_equal(result.v, nominal)


def test_rows_that_hold_stay_eased_until_they_ask_for_all_they_do_otherwise() -> None:
    """The lost row is back at once; what the other one asks for then still grows as gradually, and gets there."""
    family = replace(FAMILY, epsilon=25.0)
    parameters = BarrierParameters(**dict.fromkeys(FAMILIES, family))
    safety = SafetyFilter("issf", 2, parameters, np.full(2, 20.0), settings=FilterSettings(dt=DT, recovery=SETTINGS))
    jac = np.diag([5.0, 5.0])
    asked = jac[1, 1] ** 2 / family.epsilon
    heights = [np.array([-0.1, 0.0])] + [np.array([0.5, 0.0])] * round(1.5 * asked / (ACCELERATION * DT))
    rates = np.array([jac[1] @ safety.apply(rows_of(h, jac), np.zeros(2)).v for h in heights])
    # the command moves by less a tick than what counts as used up
    assert ACCELERATION * DT / jac[1, 1] < 0.05 * SETTINGS.acceleration * DT
    assert np.diff(rates, prepend=0.0).max() <= ACCELERATION * DT + 1e-6
    assert rates[-1] == pytest.approx(asked, abs=1e-6)


@pytest.mark.parametrize("name", QPS)
def test_lost_rows_may_have_any_layout_and_type_of_numbers(name: str) -> None:
    rng = np.random.default_rng(31)
    n, nv = 6, 4
    h, jac, dh_dt = np.full(n, -0.05), rng.normal(size=(n, nv)).astype(np.float32), np.zeros(n)
    family, v_des = np.ones(n, dtype=np.intp), rng.normal(size=nv)
    expected = filter_of(n, nv, name).apply(BarrierRows(h, jac.astype(float), dh_dt, family), v_des)
    for rows in (
        BarrierRows(np.repeat(h, 2)[::2], jac.astype(float), dh_dt, family),
        BarrierRows(h, np.asfortranarray(jac, dtype=float), np.broadcast_to(0.0, (n,)), family),
        BarrierRows(h, jac, dh_dt.astype(np.float32), family),
    ):
        result = filter_of(n, nv, name).apply(rows, v_des)
        assert result.status == expected.status
        np.testing.assert_allclose(result.v, expected.v, rtol=0, atol=1e-9)


def test_a_lost_row_that_nothing_moves_has_no_say_in_how_the_others_are_left() -> None:
    rng = np.random.default_rng(32)
    for _ in range(20):
        jac, h = rng.normal(size=(4, 5)), rng.uniform(-0.05, -0.01, 4)
        with_it, without = filter_of(5, 5), filter_of(4, 5)
        for _ in range(5):
            v_des = rng.normal(scale=3.0, size=5)
            one = with_it.apply(rows_of(np.append(h, -5e-5), np.vstack([jac, np.zeros(5)])), v_des)
            two = without.apply(rows_of(h, jac), v_des)
            np.testing.assert_allclose(one.v, two.v, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["cbf", "sss"])
def test_a_lost_row_is_left_though_rows_that_hold_contradict_each_other(name: str) -> None:
    """Two obstacles come from both sides, where nothing can be done; the row that is lost has another direction."""
    jac = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    safety, dh_dt = filter_of(3, 3, name), np.array([-0.15, -0.15, 0.0])
    rates = []
    for _ in range(200):
        result = safety.apply(rows_of(np.array([1e-3, 1e-3, -0.06]), jac, dh_dt), np.zeros(3))
        assert result.status == FilterStatus.RELAXED
        rates.append(result.v[1])
    assert np.diff(rates).max() <= ACCELERATION * DT + 1e-6
    assert rates[-1] > 0.9 * SPEED


def test_a_filter_that_takes_over_goes_on_from_the_last_command() -> None:
    """In the middle of the way out: told the last command it changes it by a little, else it starts from rest."""
    jac, h, v_des = np.eye(1, 2), np.array([-0.05]), np.zeros(2)
    first = filter_of(1, 2)
    for _ in range(60):
        last = first.apply(rows_of(h, jac), v_des).v
    told, untold = filter_of(1, 2, "issf"), filter_of(1, 2, "issf")
    told.resume(v_des, last)
    changes = [np.abs(f.apply(rows_of(h, jac), v_des).v - last).max() for f in (told, untold)]
    assert last[0] > 0.1
    assert changes[0] < 0.02
    assert changes[1] > 0.1

"""States as they come in: each once, in order, whole, with stamps that the network's jitter does not shake."""

import numpy as np
import pytest

from robots.loader import load_robot
from robots.messages import SensorReading
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import StateMessage
from robots.unitree.motor_faults import MOTOR_FAULTS, TIMED_OUT, describe_bits
from robots.unitree.stream import LONGEST_GAP, PERIOD, StateClock, StateStream

JOINTS = G1Joints(load_robot("g1"))


def state(tick: int) -> bytes:
    message = StateMessage()
    reading = SensorReading(np.zeros(29), np.zeros(29), np.zeros(29), np.zeros(3), np.array([0.0, 0.0, 9.81]), 0.0)
    JOINTS.write_state(reading, np.array([0.0, 0.0, 0.0, 1.0]), message, tick)
    return message.sealed()


def test_a_state_counts_once_and_none_that_is_older() -> None:
    stream = StateStream(JOINTS)
    assert stream.take(state(10), 0.0) is not None
    assert stream.take(state(10), 0.001) is None
    assert stream.take(state(8), 0.002) is None
    assert stream.take(state(12), 0.003) is not None
    assert (stream.repeated, stream.message.tick, stream.arrived) == (2, 12, 0.003)


def test_a_broken_state_changes_nothing() -> None:
    stream = StateStream(JOINTS)
    assert stream.take(state(10), 0.0) is not None
    broken = bytearray(state(12))
    broken[200] ^= 1
    assert stream.take(bytes(broken), 0.002) is None
    assert stream.take(b"short", 0.002) is None
    assert (stream.broken, stream.message.tick) == (2, 10)
    assert stream.take(state(12), 0.002) is not None


@pytest.mark.parametrize("unit", [1, 2, 1000])
def test_stamps_are_even_where_arrivals_are_not(unit: int) -> None:
    rng, clock = np.random.default_rng(0), StateClock()
    true = PERIOD * np.arange(3000)
    stamps = np.array([clock.advance(7 + unit * i, t + 1e-3 * rng.random()) for i, t in enumerate(true)])
    steps = np.diff(stamps)
    assert np.abs(steps - PERIOD).max() < 2.5e-5
    # half of the jitter is the mean delay, which nothing tells from time
    assert abs(stamps[1000:] - true[1000:] - 5e-4).max() < 2e-4


def test_the_counter_tells_how_many_were_lost() -> None:
    clock = StateClock()
    for i in (0, 1, 2, 6, 7):
        stamp = clock.advance(2 * i, PERIOD * i)
    assert clock.lost == 3
    assert stamp == pytest.approx(7 * PERIOD, abs=1e-9)


def test_the_counter_may_start_again_from_zero() -> None:
    clock = StateClock()
    last = (1 << 32) - 2
    clock.advance(last, 0.0)
    assert clock.step(0) == 2
    assert clock.advance(0, PERIOD) == pytest.approx(PERIOD)
    assert clock.step(last) < 0


def test_a_burst_after_a_wait_does_not_put_the_clock_ahead() -> None:
    """What waited somewhere comes at once: soon stamps are not later than arrivals by more than a period."""
    clock = StateClock()
    for i in range(60):
        clock.advance(i, 0.12)
    for i in range(60, 400):
        stamp = clock.advance(i, PERIOD * i)
    assert stamp <= PERIOD * 399 + PERIOD
    assert stamp >= PERIOD * 399 - PERIOD


def test_stamps_never_go_back() -> None:
    rng, clock, stamps, tick, t = np.random.default_rng(1), StateClock(), [], 0, 0.0
    for _ in range(2000):
        tick += int(rng.integers(1, 4))
        t += float(rng.choice([0.0, PERIOD, 5 * PERIOD, 2 * LONGEST_GAP], p=[0.3, 0.5, 0.15, 0.05]))
        stamps.append(clock.advance(tick, t))
    assert (np.diff(stamps) > 0.0).all()


def test_bits_of_a_motor_in_words() -> None:
    assert describe_bits(0x1) == "overcurrent"
    assert describe_bits(TIMED_OUT | 0x200) == "winding too hot, waited too long for a command"
    assert describe_bits(0x80000000) == "bits 0x80000000"
    assert all(bit & (bit - 1) == 0 for bit in MOTOR_FAULTS)

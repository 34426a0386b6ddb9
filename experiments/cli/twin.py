"""``safewbc twin``: a process that plays a G1 as time passes, told what to do by lines of its standard input."""

import gc
import math
import os
import select
import signal
import sys
import time
from importlib.util import find_spec

from experiments.scenarios.hardware_options import TwinOptions
from experiments.scenarios.options import PlantOptions, SensingOptions
from experiments.scenarios.resolve import plant_config, sensor_errors
from robots.checks import require_between, require_positive
from robots.clocks import SharedClock
from robots.errors import ConfigError, SafeWbcError
from robots.loader import load_robot
from sims.twin.faults import FAULTS
from sims.twin.lockstep import Lockstep
from sims.twin.orders import VERBS, load_script
from sims.twin.pace import Pace
from sims.twin.ports import MemoryPorts
from sims.twin.record import Record
from sims.twin.twin import STEP, Twin, TwinConfig

PRIORITY = 40
"""Of the process among those in real time, where it may be one."""

LOOK_PERIODS = 5
"""Periods from look to look at standard input."""

REPORT_PERIODS = 60_000
"""Periods from report to report at a terminal."""

UNSTABLE = 1
"""Exit code when the simulation blew up."""


def twin(options: TwinOptions) -> int:
    """Play the robot until told to end; 0, or 1 where the simulation blew up.

    Raises:
        SafeWbcError: an option is not allowed, or cyclonedds is not installed.
    """
    config = checked(options)
    script = load_script(options.script) if options.script is not None else ()
    record = Record(options.record) if options.record is not None else None
    clock = SharedClock.create(options.clock, time.monotonic()) if options.clock is not None else None
    if find_spec("cyclonedds") is None:
        raise SafeWbcError("cyclonedds is not installed: pip install 'safewbc[g1]'")
    robot = load_robot(options.robot)
    rehearse(Twin(robot, config, ports := MemoryPorts(), ports))
    scheduled = schedule(options.cpu, options.clock is None)

    from robots.unitree.switcher import SwitcherService
    from sims.twin.dds_ports import DdsPorts

    dds = DdsPorts(options.domain, options.interface)
    played = Twin(robot, config, dds, SwitcherService(dds.network), script, record, tell)
    pace: Pace | Lockstep = Pace(STEP) if clock is None else Lockstep(STEP, clock, dds.debt)
    run(played, pace, options.duration if options.duration is not None else math.inf)
    for line in [f"scheduling: {scheduled}", *report(played, pace)]:
        tell(line)
    if record is not None:
        record.save(played.events)
        tell(f"record: {options.record}")
    return UNSTABLE if played.plant.unstable else 0


def checked(options: TwinOptions) -> TwinConfig:
    """The twin of the options.

    Raises:
        ConfigError: one of them is not allowed.
    """
    if not 1 <= options.domain <= 230:
        raise ConfigError("domain", options.domain, "from 1 to 230: 0 is the robot's, and a twin must not be on it")
    require_positive("motor_timeout", options.motor_timeout)
    if options.duration is not None:
        require_positive("duration", options.duration)
    require_between("seed", options.seed, 0, 2**32 - 1)
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    if options.cpu is not None and options.cpu not in cores:
        raise ConfigError("cpu", options.cpu, "left out, or one of " + ", ".join(map(str, cores)))
    errors = sensor_errors(
        SensingOptions("estimated", options.sensor_errors, options.gyro_drift, options.torque_constant)
    )
    plant = plant_config(PlantOptions(mass_scale=options.mass_scale, friction=options.friction))
    return TwinConfig(plant, errors, options.motor_timeout, options.on_timeout, options.seed)


def rehearse(played: Twin) -> None:
    """Go once through what a period does, so that none of it happens for the first time when it counts."""
    for _ in range(50):
        played.step(played.time)


def schedule(cpu: int | None, first: bool) -> str:
    """Choose core and priority, before there is a participant whose threads inherit them; returns what came of it.

    Args:
        cpu: core; any if not given.
        first: whether it comes before others, as what keeps real time has to.
    """
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    where = "any core" if cpu is None else f"core {cpu}"
    if not first:
        return f"ordinary priority, {where}"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (OSError, AttributeError):
        return f"ordinary priority, {where}"
    return f"FIFO {PRIORITY}, {where}"


def run(played: Twin, pace: Pace | Lockstep, duration: float) -> None:
    """Play until the end, at the times of ``pace``."""
    asked: list[int] = []
    before = {number: signal.signal(number, lambda n, _: asked.append(n)) for number in (signal.SIGINT, signal.SIGTERM)}
    lines, terminal = Lines(), sys.stdout.isatty()
    gc.collect()
    gc.freeze()
    gc.disable()
    played.say("ready")
    if terminal:
        tell("orders: " + ", ".join((*VERBS, *FAULTS)))
    try:
        while not (played.ended or asked or played.plant.unstable or played.time >= duration - STEP / 2):
            played.step(pace.wait())
            if pace.periods % LOOK_PERIODS == 0:
                obey(played, pace, lines)
            if terminal and pace.periods % REPORT_PERIODS == 0:
                show(played, pace)
    finally:
        gc.enable()
        gc.unfreeze()
        for number, handler in before.items():
            signal.signal(number, handler)
    if played.plant.unstable:
        played.say("the simulation became unstable")
    elif not played.ended:
        played.say(f"end: {signal.Signals(asked[0]).name}" if asked else "end: duration")
    pace.stop()


def obey(played: Twin, pace: Pace | Lockstep, lines: "Lines") -> None:
    """Carry out what has come from standard input."""
    for line in lines.take():
        order = played.obey(line)
        if order is not None and order.verb == "status":
            show(played, pace)


def show(played: Twin, pace: Pace | Lockstep) -> None:
    """Print the sums up to now."""
    for line in report(played, pace):
        tell(line)


def report(played: Twin, pace: Pace | Lockstep) -> list[str]:
    """The sums: time kept, commands taken and refused, the one in use."""
    board = played.board
    refused = ", ".join(f"{n} {cause}" for cause, n in board.refused.items() if n) or "none"
    released = board.service is None
    age = board.age(pace.now())
    used = f"{age:.3f} s old" if math.isfinite(age) else "none" if released else "the service's"
    if board.timed_out(pace.now()):
        used += f": the motors have timed out, and {board.reaction}"
    return [
        *pace.told(played.time),
        f"LowCmd: {board.received} received, {board.accepted} accepted, refused: {refused}",
        f"command in use: {used}",
    ]


def tell(line: str) -> None:
    """Print a line at once; who listened no more is no reason to end."""
    try:
        print(line, flush=True)
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")


class Lines:
    """Lines of standard input, without waiting for one; its end is none of the twin's."""

    def __init__(self, source: int = 0) -> None:
        self._source, self._rest, self._open = source, b"", True

    def take(self) -> list[str]:
        """Those that have come whole since the last time."""
        try:
            if not self._open or not select.select([self._source], [], [], 0)[0]:
                return []
            data = os.read(self._source, 4096)
        except (OSError, ValueError):
            data = b""
        self._open = bool(data)
        *whole, self._rest = (self._rest + (data or b"\n")).split(b"\n")
        return [text for line in whole if (text := line.decode("utf-8", "replace").strip())]

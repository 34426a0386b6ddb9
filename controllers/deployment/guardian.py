"""The guardian: a process of its own that brakes the motors when the controller is silent.

It says nothing to the motors while the controller does. It takes over for good when the controller has sent nothing for
:data:`controllers.deployment.watchman.SILENCE`, whether it was killed, stopped or is late, or when somebody presses
L2 + B; then it tells the motors to brake every 2 ms, until it is ended or no state has come for ten minutes. Silence is
counted in what the guardian has watched: where the whole machine stood still, the controller gets its time again.
"""

import os
import signal
import sys
from pathlib import Path

import numpy as np

from controllers.deployment.heartbeat import Heartbeat
from controllers.deployment.realtime import GUARDIAN_PRIORITY, anywhere, freeze_garbage, lock_memory, schedule
from controllers.deployment.watchman import ASKED, SILENCE, Watchman, brake_message
from robots.clocks import MACHINE, Clock, SharedClock
from robots.description import RobotDescription
from robots.loader import load_robot
from robots.unitree.g1 import MODE_MACHINE
from robots.unitree.messages import StateMessage
from robots.unitree.stream import PERIOD

WATCH = 0.001
"""How often it looks [s]."""

ALONE = 600.0
"""Without a state, after which it ends: until then a cable that is put back finds motors that are braked [s]."""


def guard(
    path: Path,
    domain: int,
    interface: str,
    robot: RobotDescription,
    patience: float = SILENCE,
    clock: Clock = MACHINE,
) -> None:
    """Watch until told to end by a signal, by the controller's own end, or by silence of the robot.

    Args:
        path: of the heartbeat.
        domain: of DDS.
        interface: of DDS.
        robot: the description.
        patience: silence of the controller after which it takes over [s].
        clock: of the deployment.
    """
    from robots.unitree.dds import Network  # noqa: PLC0415 - its threads inherit the scheduling that was set before

    ended: list[bool] = []
    parent = os.getppid()
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTSTP):
        # what a person does at the terminal goes to every process; the controller decides
        signal.signal(number, signal.SIG_IGN)
    heart = Heartbeat(path)
    network = Network(domain, interface)
    states, commands = network.reader("rt/lowstate"), network.writer("rt/lowcmd")
    watchman, message, data = Watchman(patience), StateMessage(), brake_message(robot, MODE_MACHINE)
    lock_memory()
    freeze_garbage()
    came = due = clock.now()
    variant, buttons = MODE_MACHINE, 0
    while not ended:
        now = clock.now()
        heart.mark("guarded", now)
        newest = states.newest()
        if newest is not None:
            came = now
            if message.read(newest):
                buttons = message.buttons
                if message.mode_machine != variant:
                    variant = message.mode_machine
                    data = brake_message(robot, variant)
        if commands.readers:
            heart.mark("heard", now)
        if watchman.look(now, heart.read("sent"), buttons):
            if not heart.read("latched"):
                if watchman.cause == ASKED:
                    heart.mark("asked", now)
                heart.mark("latched", now)
                due = now
            if now >= due:
                commands.send(data)
                due = max(due + PERIOD, now)
            if now - came > ALONE:
                break
        elif heart.read("ended") or (not heart.read("sent") and os.getppid() != parent):
            # the controller has ended of itself, or whoever started this has gone before its first command
            break
        clock.sleep(WATCH if watchman.cause is None else 0.5 * WATCH)


def main(arguments: list[str]) -> None:
    """Arguments: file of the heartbeat, domain, interface, robot, patience; a simulation's clock, if it goes by one."""
    path, domain, interface, robot, patience, *clock = arguments
    np.seterr(all="ignore")
    goes_by: Clock = MACHINE
    anywhere()
    if clock:
        goes_by = SharedClock(Path(clock[0]), "guardian")
    else:
        schedule(GUARDIAN_PRIORITY)
    guard(Path(path), int(domain), interface, load_robot(robot), float(patience), goes_by)


if __name__ == "__main__":
    main(sys.argv[1:])

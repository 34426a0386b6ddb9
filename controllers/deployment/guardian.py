"""The guardian: a process of its own that brakes the motors when the controller is silent.

It says nothing to the motors while the controller does. It takes over for good when the controller has sent nothing for
:data:`SILENCE`, whether it was killed, stopped or is late, or when somebody presses L2 + B; then it tells the motors to
brake every 2 ms, until it is ended or no state comes any more. Silence is counted in what the guardian itself has
watched: where the whole machine stood still, the controller gets its time again.
"""

import signal
import sys
import time
from pathlib import Path

import numpy as np

from controllers.deployment.heartbeat import Heartbeat, Silence
from controllers.deployment.motors import brake
from controllers.deployment.realtime import GUARDIAN_PRIORITY, freeze_garbage, lock_memory, schedule
from robots.description import RobotDescription
from robots.loader import load_robot
from robots.unitree.dds import Network
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import button_bits

SILENCE = 0.010
"""Of the controller, after which the guardian takes over [s]."""

WATCH = 0.001
"""How often it looks [s]."""

PERIOD = 0.002
"""Of its commands [s]."""

ALONE = 5.0
"""Without a state, after which it ends [s]."""

SILENT, ASKED = "the controller was silent", "L2 + B at the remote"
"""Why it takes over."""

DAMP_BITS = button_bits("L2", "B")


class Watchman:
    """Decides when to take over; what it has seen is handed to it, so it can be tried without a process."""

    def __init__(self) -> None:
        self._silence = Silence()
        self.cause: str | None = None

    def look(self, now: float, sent: float, buttons: int) -> bool:
        """Whether the motors are to brake from now on.

        Args:
            now: monotonic time [s].
            sent: when the controller has sent its last command, 0 before its first [s].
            buttons: of the remote.
        """
        silence = self._silence.look(now, sent)
        if self.cause is None and sent > 0.0:
            if silence > SILENCE:
                self.cause = SILENT
            elif buttons & DAMP_BITS == DAMP_BITS:
                self.cause = ASKED
        return self.cause is not None


def brake_message(robot: RobotDescription, mode_machine: int) -> bytes:
    """The command to brake, sealed."""
    message = CommandMessage()
    G1Joints(robot).write(brake(robot, 0.0), message, mode_machine, any_variant=True)
    return message.sealed()


def guard(path: Path, domain: int, interface: str, robot: RobotDescription) -> None:
    """Watch until told to end by a signal, by the controller's own end, or by silence of the robot."""
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    # a person's Ctrl-C goes to every process of the terminal; the controller decides
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    schedule(GUARDIAN_PRIORITY)
    heart = Heartbeat(path)
    network = Network(domain, interface)
    states, commands = network.reader("rt/lowstate"), network.writer("rt/lowcmd")
    watchman, message, data = Watchman(), StateMessage(), brake_message(robot, MODE_MACHINE)
    lock_memory()
    freeze_garbage()
    heard = due = time.monotonic()
    variant, buttons = MODE_MACHINE, 0
    while not ended and not heart.read("ended"):
        now = time.monotonic()
        heart.mark("guarded", now)
        newest = states.newest()
        if newest is not None:
            heard = now
            if len(newest) == message.size and message.read(newest):
                buttons = message.buttons
                if message.mode_machine != variant:
                    variant = message.mode_machine
                    data = brake_message(robot, variant)
        if watchman.look(now, heart.read("sent"), buttons):
            if not heart.read("latched"):
                if watchman.cause == ASKED:
                    heart.mark("asked", now)
                heart.mark("latched", now)
                due = now
            if now >= due:
                commands.send(data)
                due = max(due + PERIOD, now)
            if now - heard > ALONE:
                break
        time.sleep(WATCH if not heart.read("latched") else 0.5 * WATCH)


def main(arguments: list[str]) -> None:
    """Arguments: file of the heartbeat, domain, interface, robot."""
    path, domain, interface, robot = arguments
    np.seterr(all="ignore")
    guard(Path(path), int(domain), interface, load_robot(robot))


if __name__ == "__main__":
    main(sys.argv[1:])

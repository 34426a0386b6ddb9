"""Velocity commands, and commands over time: read from a file, or any function of time.

The command of :class:`controllers.gaits.walking.Walking` may be set at any time, from wherever it comes::

    walking = Walking(kin, walk_tuning(kin.robot))
    ...
    walking.command = VelocityCommand(vx=0.2, wz=0.1)  # before any tick; the next step follows it
    walking.apply(reference, t, state, kin)
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from robots.checks import require_finite, require_non_negative
from robots.errors import ConfigError


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """How the body is to move, in its own heading.

    Attributes:
        vx: forward [m/s].
        vy: to the left [m/s].
        wz: turning to the left [rad/s].
        stepping: go on stepping where all three are zero; otherwise the robot then stops with its feet side by side.
    """

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    stepping: bool = False

    def __post_init__(self) -> None:
        for name in ("vx", "vy", "wz"):
            require_finite(name, getattr(self, name))

    def towards(self, other: "VelocityCommand", speed: float, turn: float) -> "VelocityCommand":
        """The command that goes from this one to ``other``, by at most ``speed`` [m/s] and ``turn`` [rad/s]."""
        dx, dy = other.vx - self.vx, other.vy - self.vy
        size = math.hypot(dx, dy)
        if size <= speed:
            vx, vy = other.vx, other.vy
        else:
            vx, vy = self.vx + dx * speed / size, self.vy + dy * speed / size
        wz = min(max(other.wz, self.wz - turn), self.wz + turn)
        return VelocityCommand(vx, vy, wz, other.stepping)

    def scaled(self, factor: float) -> "VelocityCommand":
        """All velocities times ``factor``."""
        return VelocityCommand(factor * self.vx, factor * self.vy, factor * self.wz, self.stepping)

    def foot_speed(self, width: float) -> float:
        """Largest speed of two places under the body, ``width`` apart, that feet have to keep up with [m/s]."""
        return math.hypot(self.vx, self.vy) + 0.5 * width * abs(self.wz)

    @property
    def walks(self) -> bool:
        """Whether the feet are to move."""
        return self.stepping or self.vx != 0.0 or self.vy != 0.0 or self.wz != 0.0


NAMED_COMMANDS = {"stop": VelocityCommand(), "step": VelocityCommand(stepping=True)}
"""What a script may call by name."""

LINE_FORMAT = "time [s] and vx [m/s], vy [m/s], wz [rad/s], or time and stop, or time and step"
"""What a line of a script may say."""

CommandProfile = Callable[[float], VelocityCommand]
"""The command at a time [s]."""


class CommandScript:
    """Commands that are valid from their times on; before the first one the robot stands.

    Args:
        times: increasing, 0 or above [s].
        commands: as many.

    Raises:
        ConfigError: the times do not rise, or are not as many as the commands.
    """

    def __init__(self, times: Sequence[float], commands: Sequence[VelocityCommand]) -> None:
        if len(times) != len(commands) or not times:
            raise ConfigError("times of a script", len(times), f"as many as commands ({len(commands)}), at least one")
        for i, time in enumerate(times):
            require_non_negative("time", time)
            if i and time <= times[i - 1]:
                raise ConfigError("time", time, f"after that of the command before it, {times[i - 1]:g} s")
        self.times = tuple(times)
        self.commands = tuple(commands)

    def __call__(self, t: float) -> VelocityCommand:
        """The command at ``t`` [s]."""
        # times of ticks are rounded: a command is valid from the very tick that it names
        i = bisect_right(self.times, t + 1e-9)
        return self.commands[i - 1] if i else VelocityCommand()


def read_script(path: Path, check: Callable[[VelocityCommand], None] | None = None) -> CommandScript:
    """Read a script: one command a line, ``#`` begins a comment, blanks or commas between the numbers.

    A line holds a time and three velocities, or a time and ``stop`` (stand with the feet side by side) or ``step`` (on
    the spot)::

        1   0.3 0 0     # forward
        8   step
        12  stop

    Args:
        path: the file.
        check: raises a ConfigError for a command that is not allowed; all are if not given.

    Raises:
        ConfigError: the file cannot be read, or a line is not allowed; names file, line and what is allowed.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("script", str(path), f"a text file that can be read ({error})") from error
    times: list[float] = []
    commands: list[VelocityCommand] = []
    for number, line in enumerate(lines, start=1):
        if not (words := line.split("#")[0].replace(",", " ").split()):
            continue
        try:
            time, command = _parse(words)
            if check is not None:
                check(command)
            # so that the error of a time that does not rise names its line
            CommandScript([*times[-1:], time], [*commands[-1:], command])
        except ConfigError as error:
            allowed = f"{error.allowed} ({error.name} = {error.value!r})"
            raise ConfigError(f"script {path}, line {number}", line.strip(), allowed) from error
        times.append(time)
        commands.append(command)
    if not times:
        raise ConfigError(f"script {path}", "no commands", "one command a line: " + LINE_FORMAT)
    return CommandScript(times, commands)


def _parse(words: list[str]) -> tuple[float, VelocityCommand]:
    """Time and command of one line."""
    try:
        if len(words) == 2 and words[1] in NAMED_COMMANDS:
            return float(words[0]), NAMED_COMMANDS[words[1]]
        time, vx, vy, wz = map(float, words)
    except ValueError as error:
        raise ConfigError("line", " ".join(words), LINE_FORMAT) from error
    return time, VelocityCommand(vx, vy, wz, stepping=vx == vy == wz == 0.0)


def between(command: CommandProfile, start: float, end: float) -> CommandProfile:
    """The commands of ``command`` from ``start`` to ``end`` [s], and to stand before and after."""
    if not (math.isfinite(start) and start <= end):
        raise ConfigError("start, end", (start, end), "two times, the first one not the later")

    def inside(t: float) -> VelocityCommand:
        return command(t) if start - 1e-9 <= t < end - 1e-9 else VelocityCommand()

    return inside

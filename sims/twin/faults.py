"""The faults that a twin can be given, by name: what each takes, checked before anything happens."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robots.errors import ConfigError
from robots.unitree.g1 import MOTOR_NAMES
from robots.unitree.remote import BUTTONS

FOREVER = math.inf
"""Of a fault that lasts until it is cleared [s]."""

JOINT, BUTTON = "joint", "button"

DEFAULT_JOINT = "left_knee"
"""Whose position is no number where a fault names none."""


@dataclass(frozen=True, slots=True)
class Argument:
    """One word behind a fault's name.

    Attributes:
        name: of the argument.
        low: least number.
        high: largest number.
        whole: whether it is a whole number; also in hexadecimal, with 0x.
        default: where it is left out; ``None``: it must be there.
        kind: ``number``, ``joint`` or ``button``; of buttons there may be several.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    whole: bool = False
    default: float | str | None = None
    kind: str = "number"

    def read(self, fault: str, word: str) -> float | str:
        """The value of a word.

        Raises:
            ConfigError: it is none of this argument.
        """
        if self.kind == JOINT:
            return _known(f"{fault} {self.name}", word.removesuffix("_joint"), MOTOR_NAMES)
        if self.kind == BUTTON:
            return _known(f"{fault} {self.name}", word, BUTTONS)
        try:
            value = int(word, 0) if self.whole else float(word)
        except ValueError:
            value = math.nan
        if not self.low <= value <= self.high:
            kind = "a whole number" if self.whole else "a number"
            raise ConfigError(f"{fault} {self.name}", word, f"{kind} from {self.low:g} to {self.high:g}")
        return value


def _known(name: str, word: str, known: Sequence[str]) -> str:
    if word not in known:
        raise ConfigError(name, word, "one of " + ", ".join(known))
    return word


def _seconds(default: float | None = FOREVER) -> Argument:
    return Argument("seconds", 0.0, 1e6, default=default)


_COUNT = Argument("count", 1, 1_000_000, whole=True, default=1)
_JOINT = Argument("joint", kind=JOINT)

FAULTS: dict[str, tuple[Argument, ...]] = {
    "state-stop": (_seconds(),),
    "state-lost": (_COUNT,),
    "state-late": (Argument("milliseconds", 1.0, 1e5, default=50.0),),
    "state-repeated": (_COUNT,),
    "state-swapped": (),
    "state-crc": (_COUNT,),
    "state-nan": (_COUNT, Argument("joint", default=DEFAULT_JOINT, kind=JOINT)),
    "encoder": (_JOINT, Argument("turns", -10.0, 10.0)),
    "hot": (_JOINT, Argument("celsius", -20.0, 300.0)),
    "motor-error": (_JOINT, Argument("bits", 0, 0xFFFFFFFF, whole=True)),
    "battery": (Argument("percent", 0, 100, whole=True),),
    "foreign-writer": (_seconds(),),
    "waist-locked": (),
    "imu-stuck": (),
    "gyro-step": (Argument("rad/s", -10.0, 10.0),),
    "network": (
        Argument("delay_ms", 0.0, 1e4),
        Argument("jitter_ms", 0.0, 1e4),
        Argument("loss_percent", 0.0, 100.0, default=0.0),
    ),
    "torque-constant": (Argument("factor", 0.1, 10.0),),
    "push": (*(Argument(f"f{axis}", -1e4, 1e4) for axis in "xyz"), _seconds(None)),
    "remote": (Argument("button", kind=BUTTON),),
    "stick": tuple(Argument(name, -1.0, 1.0) for name in ("lx", "ly", "rx")),
    "remote-lost": (),
    "switcher-refuses": (),
}
"""What stands behind each fault's name."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that is asked for.

    Attributes:
        name: one of ``FAULTS``.
        values: of its arguments, those included that were left out; all buttons of the remote.
    """

    name: str
    values: tuple[float | str, ...] = ()

    def number(self, i: int) -> float:
        """The argument ``i``, which is a number."""
        return float(self.values[i])

    def word(self, i: int) -> str:
        """The argument ``i``, which is a name."""
        return str(self.values[i])


def read_fault(words: Sequence[str]) -> Fault:
    """The fault of a line's words, its name first.

    Raises:
        ConfigError: no such fault, a word too many or too few, or one that is not allowed.
    """
    name, given = fault_name(words[0] if words else ""), words[1:]
    arguments = FAULTS[name]
    if arguments and arguments[-1].kind == BUTTON:
        arguments = arguments * max(1, len(given))
    needed = sum(argument.default is None for argument in arguments)
    if not needed <= len(given) <= len(arguments):
        raise ConfigError(name, " ".join(given), f"followed by: {usage(name) or 'nothing'}")
    values = [a.read(name, word) for a, word in zip(arguments, given, strict=False)]
    values += [a.default for a in arguments[len(given) :] if a.default is not None]
    return Fault(name, tuple(values))


def fault_name(word: str) -> str:
    """The name of a fault.

    Raises:
        ConfigError: there is none of that name.
    """
    return _known("fault", word, tuple(FAULTS))


def usage(name: str) -> str:
    """What stands behind a fault's name, in words: ``JOINT TURNS``, in brackets what may be left out."""
    words = []
    for a in FAULTS[name]:
        word = a.name.upper() + ("..." if a.kind == BUTTON else "")
        words.append(word if a.default is None else f"[{word}]")
    return " ".join(words)

"""What a motor says is wrong with it: bits of ``motorstate``.

Source: the manufacturer's page of motor errors, as the facts of the field quote it; 0x40000000 is set by a motor that
waited too long for a command.
"""

TIMED_OUT = 0x40000000
"""The motor has waited too long for a command."""

MOTOR_FAULTS = {
    0x1: "overcurrent",
    0x2: "transient overvoltage",
    0x4: "sustained overvoltage",
    0x8: "transient undervoltage",
    0x10: "chip too hot",
    0x20: "MOSFETs too hot or too cold",
    0x40: "temperature of MOSFETs abnormal",
    0x80: "shell too hot or too cold",
    0x100: "temperature of the shell abnormal",
    0x200: "winding too hot",
    0x400: "rotor encoder 1",
    0x800: "rotor encoder 2",
    0x1000: "output encoder",
    0x2000: "calibration or boot data",
    0x4000: "abnormal reset",
    0x8000: "locked",
    0x10000: "chip validation",
    0x20000: "calibration mode",
    0x40000: "communication check",
    0x80000: "driver too old",
    TIMED_OUT: "waited too long for a command",
}


def describe_bits(bits: int) -> str:
    """What the bits of ``motorstate`` say, in words."""
    known = [text for bit, text in MOTOR_FAULTS.items() if bits & bit]
    rest = bits & ~sum(MOTOR_FAULTS)
    return ", ".join(known + ([f"bits {rest:#x}"] if rest else []))

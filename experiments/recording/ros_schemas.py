"""The robot's messages in the language of ROS 2 message definitions, by which viewers decode them.

Fields in the order of :mod:`robots.unitree.layout`. What the robot's own IDL calls ``octet`` is ``uint8`` here: on the
wire both are one byte.
"""

_LINE = 80 * "="

_MOTOR_CMD = """\
# 1: the motor follows; 0: it is off
uint8 mode
# rad, rad/s, N m
float32 q
float32 dq
float32 tau
# N m/rad, N m s/rad
float32 kp
float32 kd
uint32 reserve
"""

_MOTOR_STATE = """\
uint8 mode
# rad, rad/s, rad/s^2, N m
float32 q
float32 dq
float32 ddq
float32 tau_est
# casing and winding, degrees Celsius
int16[2] temperature
# V
float32 vol
uint32[2] sensor
# bits of what is wrong
uint32 motorstate
uint32[4] reserve
"""

_IMU_STATE = """\
# w, x, y, z
float32[4] quaternion
# rad/s, m/s^2, rad
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
# degrees Celsius
int16 temperature
"""

_LOW_CMD = """\
# 0: ankles and waist as serial joints
uint8 mode_pr
# variant of the robot
uint8 mode_machine
unitree_hg/MotorCmd[35] motor_cmd
uint32[4] reserve
# over the struct in C's memory
uint32 crc
"""

_LOW_STATE = """\
uint32[2] version
# 0: ankles and waist as serial joints
uint8 mode_pr
# variant of the robot
uint8 mode_machine
# counter of the robot
uint32 tick
unitree_hg/IMUState imu_state
unitree_hg/MotorState[35] motor_state
uint8[40] wireless_remote
uint32[4] reserve
# over the struct in C's memory
uint32 crc
"""


def _whole(text: str, **parts: str) -> str:
    """A definition with those of the types in it, each behind a line and its name."""
    return text + "".join(f"{_LINE}\nMSG: unitree_hg/{name}\n{part}" for name, part in parts.items())


LOW_CMD = _whole(_LOW_CMD, MotorCmd=_MOTOR_CMD)
"""``unitree_hg/msg/LowCmd``."""

LOW_STATE = _whole(_LOW_STATE, IMUState=_IMU_STATE, MotorState=_MOTOR_STATE)
"""``unitree_hg/msg/LowState``."""

"""The robot's types as DDS knows them, whose samples are prepared bytes: nothing is encoded or decoded in Python.

``octet`` is :data:`cyclonedds.idl.types.byte` here: with ``uint8`` the types' hashes are others than the robot's, and a
peer with the release of the robot's time (0.10) dies when it discovers them.

Source of fields and names: unitree_sdk2_python, idl/unitree_hg and idl/unitree_api.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, byte, float32, int16, int32, int64, sequence, uint16, uint32

K = TypeVar("K", bound=type[IdlStruct])


def raw(kind: K) -> K:
    """Make the samples of a type their own bytes, header and all: made from them, and sent as they are."""

    def make(self: Any, data: bytes) -> None:
        self.data = data

    def serialize(self: Any, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None) -> bytes:
        return bytes(self.data)

    def deserialize(cls: Any, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Any:
        return cls(data)

    def deserialize_key(cls: Any, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Any:
        # of what says that a writer has gone: there is no key, and nothing of a sample
        return cls(b"")

    for name, method in (("__init__", make), ("serialize", serialize)):
        setattr(kind, name, method)
    for name, of_class in (("deserialize", deserialize), ("deserialize_key", deserialize_key)):
        setattr(kind, name, classmethod(of_class))
    return kind


@raw
@final
class IMUState_(IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):
    """An IMU as bytes, named as by the robot; see :data:`robots.unitree.layout.IMU`."""

    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: int16


@dataclass
@final
class MotorState_(IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):  # noqa: D101
    mode: byte
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    temperature: array[int16, 2]
    vol: float32
    sensor: array[uint32, 2]
    motorstate: uint32
    reserve: array[uint32, 4]


@dataclass
@final
class MotorCmd_(IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):  # noqa: D101
    mode: byte
    q: float32
    dq: float32
    tau: float32
    kp: float32
    kd: float32
    reserve: uint32


@raw
@final
class LowState_(IdlStruct, typename="unitree_hg.msg.dds_.LowState_"):
    """A state as bytes; see :class:`robots.unitree.messages.StateMessage`."""

    version: array[uint32, 2]
    mode_pr: byte
    mode_machine: byte
    tick: uint32
    imu_state: IMUState_
    motor_state: array[MotorState_, 35]
    wireless_remote: array[byte, 40]
    reserve: array[uint32, 4]
    crc: uint32


@raw
@final
class LowCmd_(IdlStruct, typename="unitree_hg.msg.dds_.LowCmd_"):
    """A command as bytes; see :class:`robots.unitree.messages.CommandMessage`."""

    mode_pr: byte
    mode_machine: byte
    motor_cmd: array[MotorCmd_, 35]
    reserve: array[uint32, 4]
    crc: uint32


@raw
@final
class BmsState_(IdlStruct, typename="unitree_hg.msg.dds_.BmsState_"):
    """The battery as bytes; see :data:`robots.unitree.layout.BATTERY`."""

    version_high: byte
    version_low: byte
    fn: byte
    cell_vol: array[uint16, 40]
    bmsvoltage: array[uint32, 3]
    current: int32
    soc: byte
    soh: byte
    temperature: array[int16, 12]
    cycle: uint16
    manufacturer_date: uint16
    bmsstate: array[uint32, 5]
    reserve: array[uint32, 3]


@dataclass
@final
class RequestIdentity_(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):  # noqa: D101
    id: int64
    api_id: int64


@dataclass
@final
class RequestLease_(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):  # noqa: D101
    id: int64


@dataclass
@final
class RequestPolicy_(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):  # noqa: D101
    priority: int32
    noreply: bool


@dataclass
@final
class RequestHeader_(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):  # noqa: D101
    identity: RequestIdentity_
    lease: RequestLease_
    policy: RequestPolicy_


@dataclass
@final
class Request_(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    """A request to a service of the robot: rare, so it is encoded as usual."""

    header: RequestHeader_
    parameter: str
    binary: sequence[byte]


@dataclass
@final
class ResponseStatus_(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):  # noqa: D101
    code: int32


@dataclass
@final
class ResponseHeader_(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):  # noqa: D101
    identity: RequestIdentity_
    status: ResponseStatus_


@dataclass
@final
class Response_(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    """What a service answers."""

    header: ResponseHeader_
    data: str
    binary: sequence[byte]


RAW = {
    "rt/lowcmd": LowCmd_,
    "rt/lowstate": LowState_,
    "rt/secondary_imu": IMUState_,
    "rt/lf/bmsstate": BmsState_,
}
"""Topics whose samples are bytes."""


def type_hash(kind: type[IdlStruct]) -> str:
    """The hash of a type's complete description (XTypes 1.3, 7.3.4.2), as peers compare it, in hexadecimal."""
    idl: Any = kind.__idl__
    idl.populate()
    idl.fill_type_data()
    return bytes(idl.get_type_id().value).hex()

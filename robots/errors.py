"""Exceptions of the project: one tree, every message names the thing, the value and what is allowed."""


class SafeWbcError(Exception):
    """Base of every error the project raises on purpose."""


class ConfigError(SafeWbcError, ValueError):
    """A setting has a value that is not allowed.

    Args:
        name: the setting.
        value: what it was set to.
        allowed: what it may be, in words.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        super().__init__(f"{name} = {value!r}: must be {allowed}")
        self.name = name
        self.value = value
        self.allowed = allowed

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:
        # an exception is pickled by its message alone if nothing is said, and then another process cannot hand it on
        return type(self), (self.name, self.value, self.allowed)


class WithoutEffectError(ConfigError):
    """A setting was given that has no effect beside the others: what is allowed is to leave it out."""


class DescriptionError(SafeWbcError, ValueError):
    """A robot description cannot be used.

    Args:
        file: where the description came from.
        entry: the entry at fault, for example ``body 'torso_link': mass``.
        value: what stands there.
        allowed: what may stand there, in words.
    """

    def __init__(self, file: object, entry: str, value: object, allowed: str) -> None:
        super().__init__(f"{file}: {entry} = {value!r}: must be {allowed}")
        self.file = str(file)
        self.entry = entry
        self.value = value
        self.allowed = allowed

    def __reduce__(self) -> tuple[type, tuple[str, str, object, str]]:
        return type(self), (self.file, self.entry, self.value, self.allowed)


class TargetNotSetError(SafeWbcError, ValueError):
    """A task was evaluated before it was told where to go.

    Args:
        task: its name.
    """

    def __init__(self, task: str) -> None:
        super().__init__(f"target of task {task!r}: must be set before the task is evaluated, by its set_target")
        self.task = task

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return type(self), (self.task,)


class UnknownNameError(SafeWbcError, KeyError):
    """A name (robot, frame, joint, filter, experiment) is not among the known ones."""

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        super().__init__(f"unknown {kind} {name!r}: known are {', '.join(known)}")
        self.kind = kind
        self.name = name
        self.known = known

    def __reduce__(self) -> tuple[type, tuple[str, str, list[str]]]:
        return type(self), (self.kind, self.name, self.known)

    def __str__(self) -> str:
        return str(self.args[0])

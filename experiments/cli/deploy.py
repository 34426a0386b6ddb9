"""``safewbc deploy``: drive a G1 over DDS, from connecting to latched damping."""

import dataclasses
import json
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from controllers.deployment.heartbeat import Heartbeat, memory_file
from controllers.deployment.loop import DeploymentLoop, Timing
from controllers.deployment.realtime import CONTROLLER_PRIORITY, freeze_garbage, lock_memory, pin, schedule
from controllers.deployment.ring import Kind, RingLog
from controllers.deployment.stages import BUTTONS, KEYS, Stage, explain
from controllers.deployment.watchman import SILENCE
from experiments.cli.persons import Announcer, Keyboard
from experiments.running.deployment_tasks import LOG, Built, build, name_of
from experiments.scenarios.hardware_options import DeployCommon
from robots.clocks import MACHINE, Clock, SharedClock
from robots.errors import ConfigError, SafeWbcError

SUMMARY, HEART = "deployment.json", "heartbeat"
"""Files of a deployment beside its log."""

BYTES_A_SECOND = 1_700_000
"""What the log grows by."""

GUARDIAN_START = 30.0
"""How long the guardian may take to start [s]."""

DRIVEN = frozenset(stage.value for stage in Stage) - {Stage.CONNECT, Stage.CHECKS, Stage.RELEASE}
"""Stages that are explained as they begin: of the others the lines after tell."""

FAULT = 3
"""Exit code where something other than the task's end, or a person, ended it."""

LOOPBACK = "lo"


def deploy(options: Any) -> int:
    """Drive the robot; 0 where the task came to its end or a person stopped it.

    Raises:
        SafeWbcError: an option is not allowed, or the robot is not ready; its motors have been told nothing then.
    """
    common: DeployCommon = options.common
    check_options(common)
    task = options.task
    built = build(task)
    folder = common.out or Path("runs") / f"deploy-{name_of(task)}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder.mkdir(parents=True, exist_ok=True)
    print("getting ready: kernels and both controllers go through their paths", flush=True)
    for agent in (built.standing, built.task):
        agent.warm_up()
    return Session(common, built, folder).run()


def check_options(common: DeployCommon) -> None:
    """What can be said before anything is made.

    Raises:
        SafeWbcError: an option is not allowed, or cyclonedds is not installed.
    """
    if common.yes and common.interface != LOOPBACK:
        raise ConfigError("yes", common.yes, f"left out but on {LOOPBACK}: a person decides, where a robot can be")
    if common.clock is not None and common.interface != LOOPBACK:
        raise ConfigError("clock", str(common.clock), f"left out but on {LOOPBACK}: a robot waits for nobody")
    if not 10.0 <= common.log_seconds <= 3600.0:
        raise ConfigError("log_seconds", common.log_seconds, "from 10 to 3600")
    if find_spec("cyclonedds") is None:
        raise SafeWbcError("cyclonedds is not installed: pip install 'safewbc[g1]'")


class Session:
    """One deployment from connecting to its summary."""

    def __init__(self, common: DeployCommon, built: Built, folder: Path) -> None:
        self._common, self._built, self._folder = common, built, folder
        self._clock: Clock = MACHINE if common.clock is None else SharedClock(common.clock, "deployment")
        self._announcer = Announcer(self._clock)
        self._person = Keyboard(common.yes)
        head = {"task": built.scenario, "options": _plain(common), "robot": built.robot.name}
        self._log = RingLog(folder / LOG, int(common.log_seconds * BYTES_A_SECOND), head)
        self._heart_file = memory_file(folder / HEART)
        self._heart = Heartbeat(self._heart_file, create=True)
        self._deployment = built.deployment(self._say)

    def _say(self, text: str) -> None:
        now = self._clock.now()
        self._log.write(Kind.EVENT, now, text.encode())
        self._announcer.tell(text)
        if (named := text.partition(": ")[0]) in DRIVEN:
            self._announcer.tell(explain(Stage(named)))

    def run(self) -> int:
        """Run it; the exit code."""
        from controllers.deployment.preparation import connect
        from robots.unitree.stream import StateStream

        common, say = self._common, self._say
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # a terminal that is closed is a wish to stop, not a reason to drop the robot
            signal.signal(number, lambda *_: self._person.interrupt())
        signal.signal(signal.SIGTSTP, signal.SIG_IGN)
        priority = "ordinary priority" if common.clock else schedule(CONTROLLER_PRIORITY)
        say(priority + ", " + pin(common.cpu))
        say("remote: " + "; ".join(f"{b}: {text}" for b, text in BUTTONS))
        say("keyboard, each with Enter: " + "; ".join(f"{k}: {text}" for k, text in KEYS))

        from robots.unitree.body import G1Port
        from robots.unitree.dds import Network

        guardian = None
        try:
            network = Network(common.domain, common.interface)
            port = G1Port(network, self._clock)
            say(f"{Stage.CONNECT.value}: domain {common.domain}, interface {common.interface}")
            # one of its own: what the deployment takes in is all in the log
            stream = StateStream(self._deployment.joints)
            rate = connect(port, stream)
            say(f"states at {rate:.0f} Hz")
            guardian = None if common.dry_run else self._start_guardian()
            self._check(port, stream, rate)
            if not common.dry_run:
                self._release(network, port, stream, rate)
            cause = self._drive(port)
        except BaseException:
            if not self._heart.read("sent"):
                # the motors were told nothing: there is nothing to guard
                self._heart.mark("ended", self._clock.now())
            self._log.close()
            raise
        finally:
            self._heart_file.unlink(missing_ok=True)
            self._announcer.close()
            self._clock.leave()
        return self._end(cause, guardian)

    def _start_guardian(self) -> subprocess.Popen[bytes]:
        common = self._common
        module = "controllers.deployment.guardian"
        where = [str(self._heart_file), str(common.domain), common.interface]
        arguments = [*where, self._built.robot.name, str(SILENCE), *([str(common.clock)] if common.clock else [])]
        guardian = subprocess.Popen([sys.executable, "-m", module, *arguments], start_new_session=True)
        end = time.monotonic() + GUARDIAN_START
        while not self._heart.read("guarded"):
            if time.monotonic() > end or guardian.poll() is not None:
                raise SafeWbcError("the guardian did not start: without it the robot is not driven")
            time.sleep(0.001)
            self._clock.now()
        # both have it in memory now, and nobody else is to
        self._heart_file.unlink()
        self._say(f"guardian: process {guardian.pid}")
        return guardian

    def _check(self, port: Any, stream: Any, rate: float) -> None:
        from controllers.deployment.preparation import Check, checks, require_met

        gyro = []
        self._say(Stage.CHECKS.value)
        end = self._clock.now() + 1.5
        while (now := self._clock.now()) < end:
            for data, arrived in port.receive(now + 0.1):
                if (reading := stream.take(data, arrived)) is not None:
                    gyro.append(reading.gyro)
        found = checks(stream, rate, port.battery(), np.array(gyro))
        heard = port.commanded and (self._common.dry_run or self._heart.read("heard") > 0.0)
        text = "somebody receives rt/lowcmd" if heard else "nobody receives rt/lowcmd from here"
        found.append(Check("hears us", heard, text, "the robot's board: are the types' hashes the same?"))
        for check in found:
            self._say(f"  {'ok  ' if check.met else 'FAIL'} {check.name}: {check.text}")
        require_met(found)

    def _release(self, network: Any, port: Any, stream: Any, rate: float) -> None:
        from controllers.deployment.preparation import release
        from robots.unitree.switcher import SwitcherClient

        self._say("go releases the on-board service: the robot has to hang, it will be limp")
        if not self._person.wait_for_go(port, stream):
            raise SafeWbcError("stopped before anything was sent")
        if not self._common.yes:
            self._say("once more, since a person may have taken their time:")
            self._check(port, stream, rate)
        self._say(Stage.RELEASE.value)
        release(SwitcherClient(network, clock=self._clock), port, self._say)

    def _drive(self, port: Any) -> str | None:
        common, deployment = self._common, self._deployment
        writes, clock = not common.dry_run, self._clock.now
        loop = DeploymentLoop(deployment, port, self._heart, self._log, self._person, writes, clock)
        self.timing = loop.timing
        self._say(lock_memory())
        freeze_garbage()
        port.receive(self._clock.now())
        if common.dry_run:
            self._person.end_hung_after(10.0)
            deployment.begin_dry()
        self._say(deployment.stage.value)
        try:
            return loop.run()
        finally:
            if loop.braked and not self._heart.read("latched"):
                self._heart.mark("ended", self._clock.now())

    def _end(self, cause: str | None, guardian: "subprocess.Popen[bytes] | None") -> int:
        latched = bool(self._heart.read("latched")) or not (self._heart.read("ended") or self._common.dry_run)
        deployment = self._deployment
        figures = timing_figures(self.timing) | {
            "periods_bridged": deployment.bridged,
            "states_lost": deployment.stream.clock.lost,
            "states_broken": deployment.stream.broken,
            "states_repeated": deployment.stream.repeated,
        }
        ended = deployment.end_cause
        summary = {"cause": cause, "ended": ended, "stage": deployment.stage.value, "guardian": latched} | figures
        text = json.dumps(summary, indent=2)
        (self._folder / SUMMARY).write_text(text + "\n", encoding="utf-8")
        self._log.close()
        print(f"stopped for: {cause}" + ("" if ended == cause else f"; ended: {ended}"))
        for line in told(figures):
            print("  " + line)
        if self._built.motor is not None:
            for torque, vibration in self._built.motor.report():
                print(f"  {torque:6.2f} N m: vibration {vibration:.4f} rad/s")
        if latched and guardian is not None:
            print(
                f"the guardian, process {guardian.pid}, brakes the motors. When the robot is safe: kill {guardian.pid}"
            )
        elif not self._common.dry_run:
            print("nobody commands the motors any more: the robot has to be off, or hang")
        print(f"log: {self._folder / LOG}")
        return 0 if (ended or "").startswith(EXPECTED) else FAULT


EXPECTED = ("at rest", "stop", "the motor check is over", "person", "the guardian has taken over: L2 + B")
"""What it may end with that is no fault."""


def timing_figures(timing: Timing) -> dict[str, float | int]:
    """How the deadlines were kept, in ms and counts."""
    work, age = (1e3 * np.array(values or [np.nan]) for values in (timing.work, timing.age))
    return {
        "periods": len(timing.work),
        "late": timing.late,
        "late_pairs": timing.late_pairs,
        "work_median_ms": float(np.median(work)),
        "work_p99_ms": float(np.percentile(work, 99)),
        "work_max_ms": float(work.max()),
        "age_median_ms": float(np.median(age)),
        "age_p99_ms": float(np.percentile(age, 99)),
        "age_max_ms": float(age.max()),
    }


def told(figures: Mapping[str, float | int]) -> list[str]:
    """The same for a person, with how the states came."""
    f = figures
    return [
        f"commands: {f['periods']}, {f['late']} not ready within 2 ms, {f['late_pairs']} of them in a row; "
        f"work {f['work_median_ms']:.2f} ms in the median, {f['work_p99_ms']:.2f} p99, {f['work_max_ms']:.2f} at most",
        f"states: {f['periods_bridged']} periods without a new sound one; {f['states_lost']} lost, "
        f"{f['states_broken']} with a wrong check sum, {f['states_repeated']} repeated or old; "
        f"age when answered {f['age_median_ms']:.2f} ms in the median, {f['age_p99_ms']:.2f} p99, "
        f"{f['age_max_ms']:.2f} at most",
    ]


def _plain(common: DeployCommon) -> dict[str, Any]:
    table = dataclasses.asdict(common)
    return table | {name: None if table[name] is None else str(table[name]) for name in ("out", "clock")}

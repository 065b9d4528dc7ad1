"""Two turntables on one serial chain: ``stage.driver = "turntable"``."""

import re

from gonio.errors import DeviceError
from gonio.rig import Driver, StageConfig
from gonio_drivers.drive import Drive, DriveState, MotorConfig
from gonio_drivers.lines import open_line
from gonio_drivers.two_axes import open_two_axes

FAULTS = {"-": None, "L": "it met a limit switch", "S": "it stalled", "D": "its motor is off"}
FORMS = {"QS": r"-?\d+,[IM],[RU],.", "ID": r".+"}  # of an answer; those to commands are empty


class TurntableAxis(MotorConfig):  # limits, speed, scale, backlash and more are in there
    device: int  # number on the chain, 1 to 9


class TurntableStage(StageConfig):
    theta_i: TurntableAxis
    theta_mes: TurntableAxis


class TurntableDrive(Drive):  # a method of `Drive` that is not needed may be left out: it does nothing
    device = ""  # named below
    start_latency_s = 0.0  # QS says moving as soon as MA is answered
    reports_reference = True  # R or U in QS: a restart is seen

    def __init__(self, line, name, config):
        self.line, self.config = line, config
        self.device = f"{name} (turntable {config.device}) on the {line.device}"
        self.model = self.ask("ID")
        self.resume()

    def describe(self):
        return self.model

    def resume(self):  # on connecting and after every interruption
        if self.ask("ID") != self.model:
            raise DeviceError(self.device, "is another one than before", "check the cables")
        for letters, per_deg in (("SP", self.config.speed_deg_s), ("AC", self.config.acceleration_deg_s2)):
            self.ask(f"{letters}{abs(self.config.steps_per_deg) * per_deg:.0f}")

    def state(self):  # one reply, so it is all of one instant
        steps, motion, known, fault = self.ask("QS").split(",")
        return DriveState(int(steps), motion == "M", known == "R", FAULTS.get(fault, fault), "free its way")

    def move_to(self, position_steps):
        self.command(f"MA{position_steps}")  # sent once: a lost answer does not mean a lost command

    def home(self):
        self.command("HO")

    def stop(self):
        self.ask("ST")

    def clear_faults(self):
        self.ask("CL")

    def ask(self, text):  # sent again if the answer fails: for what may be repeated
        return self.line.query(lambda: self.command(text))

    def command(self, text):
        with self.line.transaction(lambda: self.exchange("ID")):  # no late answer looks like an identity
            return self.exchange(text)

    def exchange(self, text):
        self.line.send(f"{self.config.device}{text}\r".encode())
        reply = self.line.read_until(b"\r", self.line.deadline_s()).decode("latin-1")
        form = rf"{self.config.device}(\?\?.*|{text[:2]}{FORMS.get(text[:2], '')})"
        if not re.fullmatch(form, reply):
            raise self.line.damaged(reply.encode("latin-1"), f"not an answer to '{text}'")
        self.line.answered()
        if reply[1:3] == "??":
            raise DeviceError(self.device, f"refused '{text}' ({reply[3:]})", "see its manual")
        return reply[3:]


def open_stage(config, context):
    line = open_line("stage", config.address, context, baudrate=9600)
    return open_two_axes(config, context, line, lambda name, table: TurntableDrive(line, name, table))


driver = Driver("stage", TurntableStage, open_stage)

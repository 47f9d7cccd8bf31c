"""The live cell with the emulated hand, and what a test sees of it."""

from common.buslog import log_files, read_log
from common.topics import HAND_JOINTS, TWIN_FRAME
from deploy import arm
from tests.faults.cell import HEARD, Ear, LiveCell
from tests.faults.hand_cell import DIE


class TwinCell(LiveCell):
    heard_too = (HAND_JOINTS,)

    def listen(self):
        self.ear = Ear(self.port, self.config, "die", (*HEARD, *self.heard_too))
        return self.ear

    def arm(self, *options):
        words = [word for item in self.sets for word in ("--set", item)]
        return arm.main([self.config, *words, *options])

    @property
    def state(self):
        sample = self.heard.newest(HAND_JOINTS)
        return sample.message.state if sample else ""

    def said(self):
        """The newest state of everybody, for a test that fails."""
        return {name: health.state for name in self.processes() if (health := self.heard.health(name))}

    def physics(self, since_ns):
        """What the emulator noted of its twin since then, from its own bus log."""
        found = []
        for path in log_files(self.run_dir / "log", "emulator"):
            entries = (entry for entry in read_log(path) if entry.key == TWIN_FRAME.key)
            found += [DIE.decode(entry.key, entry.payload).message for entry in entries]
        return [frame for frame in found if frame.t_ns > since_ns]

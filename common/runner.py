"""What all three runners share: stamping, encoding, logging and routing a service's outputs."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Mapping

from common.bus import Bus, Inbox, JobResult
from common.buslog import Entry, LogSink, NoLog
from common.codec import Codec, Refused
from common.messages import Header, Message
from common.service import Finish, Job, Output, Port, Publish, Service, ToPort
from common.topics import Topic, topic_of


class Dispatcher:
    """Carries out one service's outputs and keeps its log.

    `start_job` is the runner's own way of doing long work. A message that breaks its own contract is not
    sent: it is counted in `unsendable`, and `last_error` says why.
    """

    def __init__(
        self,
        service: Service,
        codec: Codec,
        bus: Bus,
        ports: Mapping[str, Port],
        log: LogSink | None = None,
    ) -> None:
        self.service = service
        self.inbox = Inbox(codec, service.inputs)
        self._codec = codec
        self._bus = bus
        self._ports = ports
        self._log = NoLog() if log is None else log
        self._seq: Counter[str] = Counter()
        self._now_ns = 0
        self.unsendable = 0
        self.last_error = ""
        self.finish: Finish | None = None

    def open(self) -> None:
        """Subscribe the service's inputs, open its ports, and let it make a first step of its own accord."""
        for spec in self.service.inputs:
            if not spec.topic.key.startswith("port/"):
                self._bus.subscribe(spec.topic, self.inbox.sink(spec.topic))
        for port in self._ports.values():
            port.open(self._from_port)
        self.inbox.wake.set()

    def _from_port(self, topic: Topic, message: Message) -> None:
        self.inbox.sink(topic)(topic.key, self._encode(topic.key, message, self._now_ns, True))

    def step(self, now_ns: int, ticks: int, start_job: Callable[[Job], None]) -> None:
        """Collect inputs, let the service advance, carry out what it wants."""
        self._now_ns = now_ns
        arrived, results = self.inbox.collect(now_ns, ticks)
        self._log_inputs(now_ns, ticks, arrived, results)
        self.carry_out(now_ns, self.service.step(now_ns, self.inbox), start_job)

    def _log_inputs(
        self, now_ns: int, ticks: int, arrived: list[tuple[str, bytes]], results: list[JobResult]
    ) -> None:
        for key, payload in arrived:
            if topic_of(key).logged:
                self._log.write(Entry("in", now_ns, key, payload))
        for result in results:
            duration = struct.pack("<q", result.duration_ns)
            self._log.write(Entry("result", now_ns, result.name, duration))
        self._log.write(Entry("step", now_ns, self.service.name, struct.pack("<q", ticks)))

    def carry_out(self, now_ns: int, outputs: list[Output], start_job: Callable[[Job], None]) -> None:
        """Send, command, begin or finish, in the order given."""
        self._now_ns = now_ns
        for output in outputs:
            match output:
                case Publish():
                    self.publish(output, now_ns)
                case ToPort():
                    self._command(output, now_ns)
                case Job():
                    start_job(output)
                case Finish():
                    self.finish = output

    def publish(self, output: Publish, now_ns: int) -> None:
        """Stamp, encode, log and send one message."""
        key = output.topic.key.replace("*", output.suffix)
        t_ns = now_ns if output.t_ns is None else output.t_ns
        try:
            payload = self._encode(key, output.message, t_ns, output.valid)
        except Refused as error:
            self._count_unsendable(key, error)
            return
        if output.topic.logged:
            self._log.write(Entry("out", now_ns, key, payload))
        self._bus.publish(output.topic, key, payload)

    def _command(self, output: ToPort, now_ns: int) -> None:
        try:
            payload = self._encode(output.topic.key, output.message, now_ns, True)
        except Refused as error:
            self._count_unsendable(output.topic.key, error)
            return
        self._log.write(Entry("out", now_ns, output.topic.key, payload))
        self._ports[output.port].write(output.message)

    def _count_unsendable(self, key: str, error: Refused) -> None:
        self.unsendable += 1
        self.last_error = f"{key}: not sent: {error}"

    def _encode(self, key: str, message: Message, t_ns: int, valid: bool) -> bytes:
        header = Header(self.service.boot_id, self._seq[key], t_ns, valid)
        self._seq[key] += 1
        return self._codec.encode(header, message)

    @property
    def log_failed(self) -> str:
        """Why the log has ended, or an empty text."""
        return self._log.failed

    @property
    def dropped(self) -> dict[str, int]:
        """Frames lost per key, by the transport or because they were not read in time."""
        return dict(Counter(self.inbox.dropped) + Counter(self._bus.misses))

    def flush(self) -> None:
        """Hand the log to the operating system."""
        self._log.flush()

    def close(self, now_ns: int) -> None:
        """Let the service save, close ports and log."""
        self.carry_out(now_ns, self.service.stop(now_ns), lambda _: None)
        for port in self._ports.values():
            port.close()
        self._log.close()


def run_job(job: Job) -> tuple[object, str]:
    """Do the work; return (value, "") or (None, the error as one line)."""
    try:
        return job.function(*job.arguments), ""
    except Exception as error:  # a failed job must not end the service: it is told, counts and shows it
        text = " ".join(str(error).split()) or type(error).__name__
        return None, f"{type(error).__name__}: {text}"

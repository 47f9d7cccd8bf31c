"""What is drawn can be read back, from the live file and from bus logs."""

import logging
import socket
import time

import numpy as np
import pytest
import yaml
from rerun.chunk import RrdReader

from common.built import codec_for
from common.buslog import BusLog, Entry
from common.cell import SharedConfig
from deploy import record
from deploy.viewer.config import ViewerConfig
from deploy.viewer.dashboard import Dashboard, next_path
from deploy.viewer.recording import vertex_normals
from services.sim.scene import SceneMesh
from tests.unit.deploy.viewer_samples import START_NS, chunk, step

STEPS = 60


def samples():
    rng = np.random.default_rng(0)
    for k in range(STEPS):
        if k:
            yield chunk("reach", k - 1, seq=k)
        yield step("reach", k, seq=k, prev_action=rng.uniform(-1, 1, 20).astype(np.float32))


def read(path, entity, column):
    """Times of the step axis and values of one column, in the order of the steps."""
    rows = []
    for part in RrdReader(path).stream().filter(content=f"/{entity}"):
        if not part.is_static:
            batch = part.to_record_batch()
            name = next(name for name in batch.schema.names if name.endswith(f":{column}"))
            rows += zip(batch["step"].to_pylist(), batch[name].to_pylist(), strict=True)
    return sorted(rows)


def check(path):
    """Compare a recording with `samples`."""
    executed = read(path, "actions/all", "scalars")
    sent = [s.message.prev_action for s in samples() if s.key == "control/step"]
    assert [k for k, _ in executed] == list(range(STEPS - 1))
    np.testing.assert_allclose([values for _, values in executed], sent[1:], atol=1e-7)
    frames = read(path, "world/hand", "child_frame")
    assert len(frames) == 31 * STEPS
    assert {frame[0] for _, frame in frames} >= {"palm", "ffdistal", "goal_th"}
    texts = [text[0] for _, text in read(path, "log/plant", "text")]
    assert texts[0] == "plant: episode 0 begins: plan"


@pytest.fixture
def shared(tmp_path):
    return SharedConfig(run_dir=tmp_path)


def test_a_recording_reads_back_what_was_sent(shared, tmp_path):
    dashboard = Dashboard(shared, ViewerConfig(serve=False))
    dashboard.open()
    for sample in samples():
        dashboard.draw([sample])
    dashboard.close()
    check(tmp_path / "recording-0.rrd")


def test_a_restart_begins_a_new_file(tmp_path):
    assert next_path(tmp_path).name == "recording-0.rrd"
    (tmp_path / "recording-0.rrd").touch()
    assert next_path(tmp_path).name == "recording-1.rrd"


def test_it_serves_locally_and_leaves_nothing_behind(shared):
    ports = [free_port(), free_port()]
    dashboard = Dashboard(shared, ViewerConfig(grpc_port=ports[0], web_port=ports[1], save=False))
    dashboard.open()
    assert dashboard.url.startswith(f"http://127.0.0.1:{ports[1]}")
    assert eventually(lambda: all(answers(port) for port in ports))
    dashboard.draw(samples())
    dashboard.close()
    assert eventually(lambda: not any(answers(port) for port in ports))


def test_a_taken_port_costs_the_dashboard_and_not_the_recording(shared, tmp_path, caplog):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        dashboard = Dashboard(shared, ViewerConfig(grpc_port=taken.getsockname()[1]))
        begin = time.perf_counter()
        with caplog.at_level(logging.WARNING):
            dashboard.open()
            dashboard.draw(samples())
            dashboard.close()
        assert time.perf_counter() - begin < 10.0
    assert dashboard.url == ""
    assert "in use" in caplog.text
    check(tmp_path / "recording-0.rrd")


def test_nothing_to_draw_to_is_an_error(shared):
    with pytest.raises(OSError, match="nothing to draw to"):
        Dashboard(shared, ViewerConfig(save=False, serve=False)).open()


def test_bus_logs_become_the_same_recording(tmp_path, capsys):
    write_logs(tmp_path)
    assert record.main(["to-rrd", str(tmp_path)]) == 0
    assert f"{2 * STEPS - 1} messages, 1 refused" in capsys.readouterr().out
    check(tmp_path / "log.rrd")


def write_logs(run_dir):
    """Sender and receiver have logged each message; one log holds a payload that is no message."""
    (run_dir / "config").mkdir()
    (run_dir / "config" / "sim.yaml").write_text(yaml.safe_dump({"task": "reach", "sim": {"seed": 1}}))
    codec = codec_for("reach")
    logs = {name: BusLog(run_dir / "log", name, 5, 10**9, 10**9) for name in ("sim", "planner")}
    for number, sample in enumerate(samples()):
        payload = codec.encode(sample.header, sample.message)
        sender, receiver = ("planner", "sim") if sample.key == "control/chunk" else ("sim", "planner")
        t_ns = START_NS + 1000 * number
        logs[sender].write(Entry("out", t_ns, sample.key, payload))
        logs[receiver].write(Entry("in", t_ns + 10, sample.key, payload))
    logs["sim"].write(Entry("in", START_NS + 10**9, "control/step", b"nonsense"))
    logs["sim"].write(Entry("in", START_NS + 10**9, "future/topic", b"nonsense"))
    for log in logs.values():
        log.close()


def test_a_folder_without_a_run_is_one_line(tmp_path, capsys):
    assert record.main(["to-rrd", str(tmp_path)]) == 2
    assert "no configuration" in capsys.readouterr().err


def test_normals_point_outwards():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]], np.float32)
    mesh = SceneMesh(vertices, np.array([[0, 1, 2]], np.int32), np.ones(4, np.float32))
    np.testing.assert_allclose(vertex_normals(mesh), [[0, 0, 1]] * 3 + [[0, 0, 0]])


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(port):
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex(("127.0.0.1", port)) == 0


def eventually(condition, timeout_s=10.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False

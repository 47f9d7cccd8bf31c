"""A service that is fed its own log decides the same again; a log that was changed is found out."""

import json
from dataclasses import replace

import pytest

from common.buslog import BusLog, Entry, log_files
from common.replay import Comparison, Replay, ReplayError
from common.topics import CHUNK, HEALTH, STEP
from deploy.replay import main
from tests.lockstep.world import BOOTS, CODEC, PROCESSES, SECTIONS, World, entries
from tests.samples import HEALTH_0


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return World(tmp_path_factory.mktemp("recorded")).run().run_dir


def fresh(name, directory, **control):
    """The service as it was at the start of the recorded run."""
    model, build = PROCESSES[name]
    shared = {"task": "reach", "warmup_steps": 40, "run_dir": str(directory)}
    config = model.model_validate({**shared, "control": {"steps_per_plan": 2, **control}, **SECTIONS[name]})
    return build(config, BOOTS[name]).service


def replay(name, directory, log, comparison=None, **control):
    return Replay(fresh(name, directory, **control), CODEC, comparison).run(log)


@pytest.mark.parametrize("name", PROCESSES)
def test_a_service_decides_the_same_again(name, run_dir, tmp_path):
    log = entries(run_dir, name)
    report = replay(name, tmp_path, log)
    assert report.differences == [] and report.differing == 0
    assert report.steps == sum(entry.kind == "step" for entry in log)
    assert report.frames == sum(entry.kind == "out" for entry in log) > 4


def changed(log, topic, number, change):
    """The log with frame `number` of a topic after `change(message)`; and that frame's step."""
    rows = [i for i, entry in enumerate(log) if entry.kind == "out" and entry.key == topic.key]
    at = rows[number]
    sample = CODEC.decode(topic.key, log[at].payload)
    payload = CODEC.encode(sample.header, change(sample.message))
    step = sum(entry.kind == "step" for entry in log[:at]) - 1
    return [*log[:at], replace(log[at], payload=payload), *log[at + 1 :]], step


def told(report):
    return [(d.step, d.key, d.field, d.recorded, d.replayed) for d in report.differences]


def test_a_changed_number_is_reported_with_its_field_and_both_values(run_dir, tmp_path):
    log, step = changed(entries(run_dir, "planner"), CHUNK, 3, lambda chunk: replace(chunk, score=-1.5))
    report = replay("planner", tmp_path, log)
    ((at, key, field, recorded, replayed),) = told(report)
    assert (at, key, field, recorded, report.differing) == (step, "control/chunk", "score", "-1.5", 1)
    assert float(replayed) != -1.5
    assert str(report.differences[0]) == (f"step {step}: control/chunk: score: recorded -1.5, now {replayed}")


def bent(chunk):
    actions = chunk.actions.copy()
    actions[1, 7] *= 0.5
    return replace(chunk, actions=actions, snapshot_id="other")


def test_of_an_array_the_worst_place_is_shown(run_dir, tmp_path):
    log, step = changed(entries(run_dir, "planner"), CHUNK, 0, bent)
    report = replay("planner", tmp_path, log)
    assert [(d.step, d.field) for d in report.differences] == [(step, "actions"), (step, "snapshot_id")]
    assert report.differences[0].recorded.startswith("[1, 7] ")
    assert report.differences[0].replayed.startswith("[1, 7] ")
    assert report.differences[1].recorded == "'other'"


def test_fields_may_be_ignored_or_differ_by_a_tolerance(run_dir, tmp_path):
    log, _ = changed(
        entries(run_dir, "planner"), CHUNK, 3, lambda c: replace(c, score=c.score + 0.01, solve_ms=51.0)
    )
    lenient = Comparison(frozenset({"solve_ms"}), {"score": 0.011})
    assert replay("planner", tmp_path, log, lenient).differing == 0
    strict = Comparison(frozenset({"solve_ms"}), {"score": 0.009})
    assert [d.field for d in replay("planner", tmp_path, log, strict).differences] == ["score"]


def test_a_frame_that_is_missing_or_too_many_is_reported(run_dir, tmp_path):
    log = entries(run_dir, "planner")
    rows = [i for i, entry in enumerate(log) if entry.kind == "out"]
    report = replay("planner", tmp_path, log[: rows[2]] + log[rows[2] + 1 :])
    assert [(d.field, d.recorded, d.replayed) for d in report.differences] == [("(frame)", "nothing", "sent")]
    report = replay("planner", tmp_path, [*log[: rows[2]], log[rows[2]], *log[rows[2] :]])
    assert [(d.field, d.recorded, d.replayed) for d in report.differences] == [("(frame)", "sent", "nothing")]


def test_a_frame_that_is_no_message_is_reported(run_dir, tmp_path):
    log = entries(run_dir, "planner")
    at = next(i for i, entry in enumerate(log) if entry.kind == "out")
    log[at] = replace(log[at], payload=log[at].payload[:-1])
    report = replay("planner", tmp_path, log)
    assert [(d.field, d.recorded) for d in report.differences] == [
        ("(payload)", "not a message (not MessagePack)")
    ]


def test_another_input_leads_to_another_decision(run_dir, tmp_path):
    """The comparison is of decisions: what the service sees is taken from the log."""
    log = entries(run_dir, "planner")
    at = next(
        i
        for i, e in enumerate(log)
        if e.kind == "in" and e.key == STEP.key and CODEC.decode(e.key, e.payload).message.waiting
    )
    sample = CODEC.decode(STEP.key, log[at].payload)
    message = replace(sample.message, goal=sample.message.goal + 0.01)
    log[at] = replace(log[at], payload=CODEC.encode(sample.header, message))
    report = replay("planner", tmp_path, log)
    assert {"actions", "score"} <= {d.field for d in report.differences}


def test_another_configuration_is_found_out(run_dir, tmp_path):
    report = replay("planner", tmp_path, entries(run_dir, "planner"), chunk="x")
    assert report.differing == report.frames == 15
    assert {(d.field, d.recorded, d.replayed) for d in report.differences} == {
        ("actions", "shape (5, 20)", "shape (2, 20)")
    }


def test_of_many_differences_the_first_are_kept_and_all_are_counted(run_dir, tmp_path):
    report = replay("planner", tmp_path, entries(run_dir, "planner"), steps_per_plan=1)
    assert report.differing > len(report.differences) == 20
    assert report.differences[0].field == "commit"


def test_a_job_that_the_service_would_not_have_begun_is_reported(run_dir, tmp_path):
    log = entries(run_dir, "planner")
    at = next(i for i, entry in enumerate(log) if entry.kind == "result")
    log.insert(at, Entry("result", 0, "dream", bytes(8)))
    report = replay("planner", tmp_path, log)
    assert [(d.field, d.recorded, d.replayed) for d in report.differences] == [
        ("(job)", "dream finished", "under way: load")
    ]


def test_a_log_that_a_kill_has_torn_is_compared_as_far_as_it_goes(run_dir, tmp_path):
    log = entries(run_dir, "sim")
    for end in range(len(log) - 12, len(log)):
        report = replay("sim", tmp_path, log[:end])
        assert report.differing == 0
        assert report.steps == sum(entry.kind == "step" for entry in log[:end])


def test_heartbeats_are_the_live_runner_s_and_not_compared(run_dir, tmp_path):
    log = entries(run_dir, "sim")
    header = CODEC.decode(STEP.key, next(e.payload for e in log if e.key == STEP.key)).header
    beat = Entry("out", 0, HEALTH.key.replace("*", "sim"), CODEC.encode(header, HEALTH_0))
    beaten = [beat, *log[:5], beat, *log[5:]]
    assert replay("sim", tmp_path, beaten).differing == 0


def test_a_log_without_its_beginning_is_refused(run_dir, tmp_path):
    log = entries(run_dir, "sim")
    first = next(i for i, entry in enumerate(log) if entry.kind == "out")
    with pytest.raises(ReplayError, match=r"begins with .* and not with a step"):
        replay("sim", tmp_path, log[first:])


# --- the command --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PROCESSES)
def test_the_command_says_in_one_line_that_nothing_differs(name, run_dir, capsys):
    before = sorted(run_dir.rglob("*"))
    assert main([str(run_dir), name]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"start {BOOTS[name]}: ") and line.endswith(": no difference")
    assert sorted(run_dir.rglob("*")) == before  # nothing is written into the run


def copied(run_dir, target, name, log):
    """A run directory with only the log of one process."""
    (target / "config").mkdir(parents=True)
    file = f"config/{name}.yaml"
    (target / file).write_bytes((run_dir / file).read_bytes())
    sink = BusLog(target / "log", name, BOOTS[name], 20_000, 10**9)
    for entry in log:
        sink.write(entry)
    sink.close()
    return target


def test_the_command_shows_differences_as_text_and_as_json(run_dir, tmp_path, capsys):
    log, step = changed(entries(run_dir, "planner"), CHUNK, 3, lambda chunk: replace(chunk, score=-1.5))
    target = copied(run_dir, tmp_path / "run", "planner", log)
    assert len(log_files(target / "log")) > 1
    assert main([str(target), "planner"]) == 1
    verdict, line = capsys.readouterr().out.splitlines()
    assert verdict.endswith(": 1 differences")
    assert line.startswith(f"step {step}: control/chunk: score: recorded -1.5, now ")
    assert main([str(target), "planner", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["service"], told["birth"], told["differing"]) == ("planner", True, 1)
    assert told["differences"][0]["field"] == "score"
    assert main([str(target), "planner", "--ignore", "score"]) == 0


def test_the_command_says_why_it_cannot_replay(run_dir, tmp_path, capsys):
    assert main([str(tmp_path), "planner"]) == 2
    assert capsys.readouterr().err == f"planner: no log of it in {tmp_path / 'log'}\n"
    target = copied(run_dir, tmp_path / "run", "planner", entries(run_dir, "planner"))
    assert main([str(target), "planner", "--boot", "5"]) == 2
    assert "no start 5; there are 22" in capsys.readouterr().err
    log_files(target / "log")[0].unlink()
    assert main([str(target), "planner"]) == 2
    assert "the beginning of this log was deleted" in capsys.readouterr().err
    (target / "config" / "planner.yaml").write_text("speed: 3\n", encoding="utf-8")


def test_a_learner_that_had_run_before_is_said_to_differ(run_dir, tmp_path, capsys):
    target = copied(run_dir, tmp_path / "run", "learner", entries(run_dir, "learner"))
    later = BusLog(target / "log", "learner", 7, 10**8, 10**9)
    later.write(Entry("step", 10**15, "learner", bytes(8)))
    later.close()
    assert main([str(target), "learner"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("start 7: 1 steps, 0 frames compared")
    assert "had run before" in captured.err
    assert main([str(target), "learner", "--boot", "33"]) == 0
    assert capsys.readouterr().err == ""

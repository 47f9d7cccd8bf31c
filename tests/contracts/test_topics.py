"""The table of topics is complete: what is sent has a reader, and delivery is what the design says."""

import dataclasses

import pytest

from common import camera_messages, hand_messages, messages, topics
from common.topics import (
    ACK,
    CAMERA_FRAME,
    CHUNK,
    EPISODE,
    HAND_JOINTS,
    METRICS,
    OBJECT_POSE,
    PLANT_COMMAND,
    PLANT_FRAME,
    PORTS,
    SNAPSHOT,
    STEP,
    TOPICS,
    TWIN_TRUTH,
    Priority,
    topic_of,
)
from deploy.curriculum import CurriculumService
from deploy.viewer.service import ViewerService
from services.hand_io.service import HandIoService
from services.learner.service import LearnerService
from services.perception.service import PerceptionService
from services.planner.service import PlannerService
from services.sim.camera_service import CameraService
from services.sim.emulator_service import EmulatorService
from services.sim.service import SimService

SERVICES = (
    SimService,
    HandIoService,
    EmulatorService,
    CameraService,
    PerceptionService,
    PlannerService,
    LearnerService,
    CurriculumService,
    ViewerService,
)


def readers(topic):
    return {service.name for service in SERVICES for spec in service.inputs if spec.topic is topic}


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_every_topic_has_a_reader(topic):
    assert readers(topic)


def test_those_who_close_the_loop_read_what_they_must():
    assert readers(STEP) >= {"planner", "learner", "curriculum"}
    assert readers(CHUNK) >= {"sim", "hand_io"}
    assert readers(EPISODE) >= {"sim", "hand_io"}
    assert readers(ACK) >= {"sim", "hand_io", "curriculum"}
    assert readers(OBJECT_POSE) >= {"hand_io"}
    assert HAND_JOINTS.latched == 0 and not HAND_JOINTS.recovered  # droppable
    assert readers(SNAPSHOT) == {"planner"}
    assert readers(METRICS) >= {"curriculum"}
    assert readers(PLANT_FRAME) == {"sim"}


@pytest.mark.parametrize("service", SERVICES, ids=lambda service: service.name)
def test_a_service_reads_only_what_is_in_the_table_and_nothing_twice(service):
    read = [spec.topic for spec in service.inputs]
    assert all(topic in (*TOPICS, *PORTS) for topic in read)
    assert len({topic.key for topic in read}) == len(read)


def test_the_learner_misses_no_step_and_the_planner_sees_the_newest():
    specs = {(service.name, spec.topic): spec for service in SERVICES for spec in service.inputs}
    newest = {name: spec.newest for (name, topic), spec in specs.items() if topic is STEP}
    assert newest["planner"] is True
    assert newest["learner"] is newest["curriculum"] is False


def test_every_constant_stands_in_the_table_and_keys_and_messages_are_unique():
    constants = [value for value in vars(topics).values() if isinstance(value, topics.Topic)]
    assert sorted(t.key for t in constants) == sorted(t.key for t in (*TOPICS, *PORTS))
    assert len({topic.key for topic in (*TOPICS, *PORTS)}) == len(constants)
    assert len({topic.message for topic in (*TOPICS, *PORTS)}) == len(constants)


def test_every_message_class_travels_on_some_topic():
    kinds = {
        kind
        for module in (messages, hand_messages, camera_messages)
        for kind in vars(module).values()
        if dataclasses.is_dataclass(kind) and kind.__module__ == module.__name__
    }
    envelope = {messages.Header, messages.Sample}
    assert kinds - envelope == {topic.message for topic in (*TOPICS, *PORTS)}


def test_control_travels_in_real_time():
    assert STEP.priority is CHUNK.priority is Priority.REAL_TIME
    assert not STEP.block and not CHUNK.block
    assert STEP.latched >= 50 and STEP.recovered  # a whole episode for a learner that restarts
    assert CHUNK.latched == 0  # an old plan is of no use to anybody


def test_snapshots_wait_in_the_background_and_the_newest_stays():
    assert (SNAPSHOT.priority, SNAPSHOT.block, SNAPSHOT.latched) == (Priority.BACKGROUND, True, 1)
    assert [topic.key for topic in TOPICS if topic.block] == ["model/snapshot"]


def test_what_to_do_now_is_told_to_late_joiners():
    assert EPISODE.latched == 1 and EPISODE.recovered
    assert ACK.latched > 1 and ACK.recovered


def test_everything_but_pictures_is_logged():
    unlogged = [topic.key for topic in (*TOPICS, *PORTS) if not topic.logged]
    assert unlogged == ["camera/frame", "camera/preview"]


def test_pictures_never_wait_in_line():
    assert CAMERA_FRAME.ring <= 2 and CAMERA_FRAME.priority is Priority.BACKGROUND
    assert readers(CAMERA_FRAME) == {"perception"} and readers(TWIN_TRUTH) >= {"camera"}


def test_a_key_finds_its_row():
    assert all(topic_of(topic.key.replace("*", "planner")) is topic for topic in (*TOPICS, *PORTS))
    assert topic_of("port/plant") is PLANT_FRAME
    assert topic_of("port/plant/command") is PLANT_COMMAND


@pytest.mark.parametrize("key", ["", "health", "control/step/x", "control", "*", "port/plant/frame"])
def test_an_unknown_key_finds_none(key):
    with pytest.raises(KeyError):
        topic_of(key)

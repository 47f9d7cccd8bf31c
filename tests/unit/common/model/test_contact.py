"""Features of touch against MuJoCo's own kinematics and distances, and what they must not see."""

from itertools import permutations, product
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
import pytest
import torch

from common import geometry
from common.model.choose import SHAPES, coordinates_of
from common.model.contact import ContactFeatures
from common.model.kinematics import Kinematics
from common.model.shapes import Cube, Ellipsoid
from common.shadow_hand import SHADOW_HAND
from common.task import get_task
from common.task.layout import ACTUATOR_NAMES, JOINT_NAMES
from common.warmup import WarmupActions
from services.sim.plant import ShadowHandPlant

mujoco: Any = compiled_mujoco
STEPS = 12
TOUCH = 13 * 16 + 15  # features of contact, the last of all
PARTS = ("proximal", "middle", "distal")
RODS = [f"robot0:C_{finger}{part}" for finger in ("ff", "mf", "rf", "lf", "th") for part in PARTS]


@pytest.fixture(scope="module", params=["egg", "block"])
def played(request):
    """A plant, and states (T + 1, S) and actions (T, A) of an episode in which hand and object touch."""
    plant = ShadowHandPlant(request.param, seed=7)
    actions = [next(WarmupActions("mix", 20, 1, 2)) for _ in range(STEPS)]
    states = [plant.state, *(plant.step(action) for action in actions)]
    return plant, torch.tensor(np.array(states)).float(), torch.tensor(np.array(actions))


def placed(plant, state):
    plant.data.qpos[:] = plant.qpos(state.double().numpy())
    mujoco.mj_kinematics(plant.model, plant.data)
    return plant.data


def test_links_are_where_mujoco_has_them(played):
    plant, states, _ = played
    kinematics = Kinematics(SHADOW_HAND, JOINT_NAMES)
    frames = kinematics.frames(states[:, :24].T.contiguous())
    bodies = [plant.model.body(f"robot0:{name}").id for name in kinematics.index]
    for t, state in enumerate(states):
        data = placed(plant, state)
        np.testing.assert_allclose(frames.origin[:, :, t].T, data.xpos[bodies], atol=1e-5)
        turned = data.xmat[bodies].reshape(-1, 3, 3)
        np.testing.assert_allclose(frames.rotation[..., t].permute(2, 0, 1), turned, atol=1e-5)


def test_gaps_and_normals_are_those_of_mujocos_collision_shapes(played):
    plant, states, actions = played
    coordinates = coordinates_of("contact", plant.task)
    thing = plant.model.geom("object").id
    C = len(RODS)
    features = coordinates.encode(states[:-1], actions)[:, -TOUCH:]
    gaps = features[:, 9 * (C + 1) :]
    normals = features[:, 3 * (C + 1) : 6 * (C + 1)].reshape(-1, 3, C + 1)
    exact = 3e-4 if plant.task.name == "egg" else 2e-3  # a cube may be nearest at another point of the rod
    close = 0
    for t, state in enumerate(states[:-1]):
        data = placed(plant, state)
        for rod, name in enumerate(RODS):
            points = np.zeros(6)
            gap = mujoco.mj_geomDistance(plant.model, data, thing, plant.model.geom(name).id, 0.03, points)
            if gap < 0.03:
                assert gaps[t, rod] == pytest.approx(gap, abs=exact + 0.06 * abs(gap))
            if exact < gap < 0.01 and plant.task.name == "egg":
                away = (points[3:] - points[:3]) / gap
                assert float(normals[t, :, rod].numpy() @ away) > 0.99
                close += 1
    assert close > 20 or plant.task.name == "block"


def test_the_coming_posture_is_the_plants_where_nothing_touches(played):
    _, states, actions = played
    features = ContactFeatures(SHADOW_HAND, SHAPES["egg"], JOINT_NAMES, 0.04)
    coming = features._coming(states[:-1, :24].T, states[:-1, 24:48].T, actions.T).T
    thumb = slice(19, 24)
    moved = (states[1:, thumb] - states[:-1, thumb]).abs().mean()
    assert (coming[:, thumb] - states[1:, thumb]).abs().mean() < 0.3 * moved


def test_the_servos_are_those_of_the_model(played):
    plant = played[0]
    servos = {servo.joint: servo for servo in SHADOW_HAND.servos}
    for i, name in enumerate(ACTUATOR_NAMES):
        np.testing.assert_allclose(
            (servos[name].low, servos[name].high), plant.model.actuator_ctrlrange[i], atol=1e-3
        )
    assert {name for name, servo in servos.items() if servo.pull == 0.0} == {"FFJ0", "MFJ0", "RFJ0", "LFJ0"}


def alike(name):
    """Quaternions of turns after which the object looks the same."""
    if name == "egg":
        turns = [(np.cos(a / 2), 0.0, 0.0, np.sin(a / 2)) for a in (0.3, 2.0)]
        return torch.tensor([*turns, (0.0, 1.0, 0.0, 0.0)]).float()
    found = []
    for axes in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = torch.zeros(3, 3)
            matrix[range(3), axes] = torch.tensor(signs)
            if torch.linalg.det(matrix) > 0:
                found.append(quaternion(matrix))
    assert len(found) == 24
    return torch.stack(found)


def quaternion(matrix):
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, matrix.double().numpy().flatten())
    return torch.tensor(q).float()


def test_networks_do_not_see_which_of_the_alike_orientations_it_is(played):
    plant, states, actions = played
    coordinates = coordinates_of("contact", plant.task)
    state = states[4]
    seen = coordinates.encode(state, actions[4])
    assert seen.shape == (coordinates.inputs,)
    for turn in alike(plant.task.name):
        other = state.clone()
        other[57:] = geometry.multiply(state[57:], turn)
        other[51:54] = geometry.rotate(geometry.conjugate(turn), state[51:54])  # the same spin in the world
        torch.testing.assert_close(coordinates.encode(other, actions[4]), seen, atol=2e-5, rtol=1e-4)
    tilted = state.clone()
    tilted[57:] = geometry.multiply(state[57:], torch.tensor([np.cos(0.2), np.sin(0.2), 0.0, 0.0]).float())
    assert (coordinates.encode(tilted, actions[4]) - seen).abs().max() > 0.05


def test_a_change_leads_to_the_next_state(played):
    plant, states, _ = played
    coordinates = coordinates_of("object", plant.task)
    change = coordinates.change(states[:-1], states[1:])
    assert change.shape == (STEPS, coordinates.changes)
    there = coordinates.moved(states[:-1], change)
    torch.testing.assert_close(there[:, :57], states[1:, :57], atol=2e-5, rtol=1e-5)
    assert geometry.angle(there[:, 57:], states[1:, 57:]).max() < 1e-5
    flipped = states[1:].clone()
    flipped[:, 57:] *= -1
    torch.testing.assert_close(coordinates.change(states[:-1], flipped), change, atol=1e-6, rtol=1e-5)


def test_everything_is_differentiable(played):
    plant, states, actions = played
    coordinates = coordinates_of("contact", plant.task)
    state, action = states[:3].requires_grad_(), actions[:3].requires_grad_()
    moved = coordinates.moved(state, coordinates.change(state, states[3:6]))
    outputs = moved, coordinates.encode(state, action)
    for gradient in torch.autograd.grad(sum(each.sum() for each in outputs), (state, action)):
        assert torch.isfinite(gradient).all()
    state = states[5:6].detach().clone()
    step = torch.zeros_like(state)
    step[0, 5] = 1e-3  # a joint moves the gaps of its finger's rods
    leaf = state.clone().requires_grad_()
    far = slice(-TOUCH + 9 * 16, -TOUCH + 9 * 16 + 15)
    (slope,) = torch.autograd.grad(coordinates.encode(leaf, actions[5:6])[0, far].sum(), leaf)
    ends = [coordinates.encode(state + sign * step, actions[5:6])[0, far].sum().item() for sign in (1, -1)]
    assert (ends[0] - ends[1]) / 2e-3 == pytest.approx(float(slope[0, 5]), abs=2e-3)


def test_shapes_know_their_surface():
    directions = torch.nn.functional.normalize(
        torch.randn(3, 50, generator=torch.Generator().manual_seed(0)), dim=0
    )
    egg, cube = Ellipsoid((0.03, 0.03, 0.04)), Cube(0.025)
    surface = directions * torch.tensor([[0.03], [0.03], [0.04]])
    gap, normal = egg.gap(surface[:, :, None])
    torch.testing.assert_close(gap, torch.zeros(50, 1), atol=1e-6, rtol=0)
    torch.testing.assert_close(normal.norm(dim=0), torch.ones(50, 1), atol=1e-4, rtol=0)
    assert float(egg.extent(torch.tensor([[0.0], [0.0], [1.0]]))) == pytest.approx(0.04, abs=1e-6)
    points = torch.tensor([[0.035, 0.0, 0.0], [0.028, 0.029, 0.0], [0.01, 0.0, 0.0]]).T[:, :, None]
    gap, normal = cube.gap(points)
    torch.testing.assert_close(gap[:, 0], torch.tensor([0.010, 0.005, -0.015]), atol=1e-5, rtol=0)
    torch.testing.assert_close(normal[:, 1, 0], torch.tensor([0.6, 0.8, 0.0]), atol=1e-3, rtol=0)
    assert float(cube.extent(torch.tensor([[0.6], [0.8], [0.0]]))) == pytest.approx(0.035)


def test_a_task_without_such_an_object_is_refused():
    with pytest.raises(ValueError, match="reach has none of"):
        coordinates_of("contact", get_task("reach"))


def test_it_moves_to_another_device_whole(played):
    plant, states, actions = played
    coordinates = coordinates_of("contact", plant.task)
    assert torch.equal(
        coordinates.to("cpu").encode(states[0], actions[0]), coordinates.encode(states[0], actions[0])
    )
    elsewhere = coordinates.to("meta")
    assert elsewhere.encode(states[:3].to("meta"), actions[:3].to("meta")).shape == (3, coordinates.inputs)

"""Colours: what paint alone says, what pictures teach, and tables against counting by hand."""

import numpy as np

from common.dice import APPEARANCES
from common.die import DIE
from services.perception.cpu.colours import bins_of, colours_of
from services.perception.cpu.view import look_up


def odds_at(model, rgb):
    return float(model.odds.ravel()[bins_of(np.array(rgb, np.uint8))])


def test_paint_is_likely_in_any_light_and_other_colours_are_not():
    for name in ("white", "black", "red"):
        die = APPEARANCES[name].die
        model = colours_of(die)
        for shade in (0.5, 0.75, 1.0):
            body = np.clip(np.array(die.body_rgb) * shade, 0, 255)
            assert odds_at(model, body) > 1.0
        assert odds_at(model, (20, 230, 20)) < -1.0


def test_what_was_seen_beside_the_die_becomes_unlikely():
    model, grey = colours_of(DIE), np.full((4000, 3), 190, np.uint8)
    before = odds_at(model, (190, 190, 190))
    after = model.learned(grey[:0], grey)
    assert odds_at(after, (190, 190, 190)) < before - 3
    assert odds_at(model, (190, 190, 190)) == before  # the old one is as it was
    back = after.learned(np.full((40000, 3), 190, np.uint8), grey[:0])
    assert odds_at(back, (190, 190, 190)) > odds_at(after, (190, 190, 190))


def test_bins_and_smoothing_by_hand():
    assert bins_of(np.array([[0, 15, 16], [255, 128, 31]], np.uint8)).tolist() == [1, 15 * 256 + 8 * 16 + 1]
    table = np.zeros((16, 16, 16), np.float32)
    table[15, 0, 0] = 9.0
    picture = np.zeros((5, 5, 3), np.uint8)
    picture[2, 2] = 255, 0, 0
    assert np.allclose(look_up(table, picture)[1:4, 1:4], 1.0)
    assert look_up(table, picture)[0, 0] == 0.0

"""Where a take is played."""

from __future__ import annotations

import numpy as np

from depthmocap.viewing.take_player import TakePlayer


def test_time_goes_on_at_its_speed() -> None:
    player = TakePlayer(np.arange(10) * 0.1)
    assert player.index == 0 and player.wait(0.0) and not player.wait(0.0)
    player.play(True)
    player.advance(0.25)
    assert player.index == 2 and player.playing
    player.speed = 2.0
    player.advance(0.1)
    assert player.index == 4


def test_the_end_is_the_start_or_a_stop() -> None:
    player = TakePlayer(np.arange(10) * 0.1)
    player.play(True)
    player.advance(5.0)
    assert player.index == 0 and player.playing
    player.loop = False
    player.advance(5.0)
    assert player.index == 9 and not player.playing
    player.play(True)
    assert player.index == 0


def test_steps_stop_and_stay_within() -> None:
    player = TakePlayer(np.arange(10) * 0.1)
    player.play(True)
    player.step(3)
    assert player.index == 3 and not player.playing
    player.step(100)
    assert player.index == 9
    player.go_to(-5)
    assert player.index == 0
    player.set_times(np.arange(4) * 0.5, 2)
    assert player.index == 2


def test_a_single_pose_is_a_take() -> None:
    player = TakePlayer(np.zeros(1))
    player.play(True)
    player.advance(1.0)
    assert player.index == 0 and not player.playing

"""Which rigs are in which wave."""

from fleet.rollout.begin import KindRigs, choose_wave, wave_size


def rigs(kind: str, count: int) -> list[str]:
    return [f"{kind}-{number}" for number in range(count)]


def test_a_large_fleet_goes_by_shares() -> None:
    # 1 % of 2000 is 20; 10 % are 200, of which 20 have it; then all the rest
    assert wave_size(1, 2000, 0, 2000) == 20
    assert wave_size(2, 2000, 20, 1980) == 180
    assert wave_size(3, 2000, 200, 1800) == 1800


def test_a_small_kind_has_six_new_boxes_in_each_wave_and_as_many_wait() -> None:
    assert wave_size(1, 20, 0, 20) == 6
    assert wave_size(2, 20, 6, 14) == 6
    assert wave_size(1, 6, 0, 6) == 3
    assert wave_size(1, 1, 0, 1) == 0
    assert wave_size(3, 1, 0, 1) == 1


def test_a_wave_is_chosen_within_each_kind_and_the_same_at_each_call() -> None:
    kinds = {kind: KindRigs(20, rigs(kind, 20)) for kind in ("tent", "case")}
    first = choose_wave(1, kinds, {}, "rollout 1")
    assert first == choose_wave(1, kinds, {}, "rollout 1")
    assert first != choose_wave(1, kinds, {}, "rollout 2")
    assert sorted(name.partition("-")[0] for name in first) == ["case"] * 6 + ["tent"] * 6
    assert len(set(first)) == 12


def test_all_rigs_have_had_their_turn_after_the_last_wave() -> None:
    waiting, reached = {"tent": rigs("tent", 37), "odd": rigs("odd", 1)}, {"tent": 0, "odd": 0}
    totals = {kind: len(names) for kind, names in waiting.items()}
    for wave in (1, 2, 3):
        kinds = {kind: KindRigs(totals[kind], names) for kind, names in waiting.items()}
        for name in choose_wave(wave, kinds, reached, "x"):
            kind = name.partition("-")[0]
            waiting[kind].remove(name)
            reached[kind] += 1
    assert waiting == {"tent": [], "odd": []}

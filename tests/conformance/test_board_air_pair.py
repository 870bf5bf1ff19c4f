"""Two air sensors, told one by one after each report."""

from board_bench import BoardBench

from firmware_protocol.messages import AirPair, AirVerdict, SensorReport


def told(bench: BoardBench) -> list:
    bench.listen()
    return [message for _, message in bench.heard if isinstance(message, AirPair | SensorReport)]


def test_a_board_with_one_air_sensor_tells_no_pair(new_board):
    bench = BoardBench(new_board).greet()
    bench.run(3000)
    assert {type(message) for message in told(bench)} == {SensorReport}


def test_the_pair_follows_each_report(new_board):
    bench = BoardBench(new_board).greet()
    bench.board.sample_pair(24.9, 28.1, AirVerdict.APART)
    bench.run(2000)
    bench.board.sample_pair(None, 28.1, AirVerdict.ALONE)
    bench.run(1000)
    pairs = [message for message in told(bench) if isinstance(message, AirPair)]
    apart = AirPair(24.9, 28.1, AirVerdict.APART)
    assert pairs == [apart, apart, AirPair(None, 28.1, AirVerdict.ALONE)]
    assert [type(message) for message in told(bench)] == [SensorReport, AirPair] * 3

"""The server of a bench, step by step in simulated time: what it obeys and refuses, and when it
makes the tube safe.
"""

import socket
from functools import partial

import pytest

from drivers.bench.connection import Beat, Connection, Fault, MadeSafe, Reply, Request
from drivers.errors import BenchError, BenchStopped
from labdata import BadInput, Conditions, Target
from tests.drivers import plant

HOT = Conditions(mcp_v=600.0, gate_ns=1e6)


class Bench(plant.Plant):
    """A plant that keeps what its server says."""

    def __init__(self, **made) -> None:
        self.said = []
        super().__init__(**made)

    def send(self, message, descriptors=()) -> None:
        self.said.append(message)
        super().send(message, descriptors)

    def all_said(self, kind) -> list:
        return [one for one in self.said if isinstance(one, kind)]

    @property
    def last_error(self):
        return self.all_said(Reply)[-1].error

    @property
    def is_hot(self) -> bool:
        return self.lab.open[0] > 0.0 or self.lab.volts > 0.0


@pytest.fixture
def bench():
    with plant.simulated_time():
        bench = Bench()
        bench.darken()
        yield bench
    assert not bench.lab.hurts


@pytest.fixture
def hot(bench):
    bench.ask("set_conditions", HOT)
    assert bench.lab.looking
    return bench


@pytest.mark.parametrize("command", ["open", "fail", "make_safe", "__class__", "interlock"])
def test_a_client_can_ask_for_the_commands_of_a_bench_alone(bench, command):
    bench.ask(command)
    assert isinstance(bench.last_error, BadInput)
    assert f"a command must be one of set_conditions, shut_gate, .* got {command}".split(" .* ")[
        0
    ] in str(bench.last_error)


def test_no_order_goes_on_after_a_safe_action_wherever_that_struck_it():
    struck = 0
    with plant.simulated_time():
        for moment in range(30):
            bench = Bench()
            bench.darken()
            strike = Request(number=0, command="safe")
            bench.interruption = (moment, partial(_strike, bench, strike))
            bench.ask("set_conditions", HOT)
            if bench.all_said(MadeSafe):
                struck += 1
                # Struck at its very end, an order has been done, and is undone.
                assert bench.last_error is None or isinstance(bench.last_error, BenchStopped)
                assert not bench.is_hot
                assert not bench.lab.hurts
            else:
                assert bench.is_hot
    assert struck > 8


def _strike(bench, request) -> None:
    bench.server.take(request)
    bench.make_safe()


def test_work_goes_on_after_a_safe_action_that_was_asked_for(hot):
    hot.server.take(Request(number=7, command="safe"))
    hot.make_safe()
    assert not hot.is_hot
    assert hot.last_error is None
    hot.ask("set_conditions", HOT)
    assert hot.lab.looking


def test_no_work_goes_on_after_a_failure(hot):
    hot.lab.supply.line.break_down("wrong")
    hot.passes(1.0)
    assert not hot.is_hot
    hot.lab.supply.line.mend()
    hot.ask("set_conditions", HOT)
    assert isinstance(hot.last_error, BenchError)
    assert not hot.is_hot


def test_the_client_knows_of_a_failure_before_the_gate_is_shut_and_gets_the_report(hot):
    hot.said.clear()
    hot.lab.supply.line.break_down("wrong")
    hot.passes(1.0)
    assert [type(one) for one in hot.said] == [Fault, MadeSafe, MadeSafe]
    assert [one.is_warning for one in hot.said[1:]] == [True, False]
    assert hot.said[2].report.gate_shut


def test_a_client_that_is_silent_for_half_a_second_ends_the_server(hot):
    hot.silent_until_s = plant.CLOCK.now_s + 0.3
    hot.passes(0.5)
    assert hot.is_hot
    hot.silent_until_s = float("inf")
    hot.passes(0.7)
    assert hot.over
    assert not hot.is_hot


def test_a_silence_at_rest_may_last_as_long_as_a_busy_machine_takes(bench):
    bench.silent_until_s = float("inf")
    bench.passes(9.5)
    assert not bench.over
    bench.passes(1.0)
    assert bench.over


def test_what_a_run_asks_for_after_a_slow_disk_counts_as_life(bench):
    bench.run_hangs_until_s = float("inf")
    bench.passes(2.5)
    bench.ask("set_conditions", HOT)
    bench.server.react()
    assert bench.is_hot and not bench.all_said(Fault)
    bench.passes(1.5)
    assert not bench.is_hot


def test_a_busy_machine_has_longer_limits_and_is_said_once(hot):
    said = []
    hot.server._delay._log = lambda event, **details: said.append((event, details))
    for _ in range(2):
        hot.server.take(Beat(delay_s=0.2))
    hot.silent_until_s = float("inf")
    hot.passes(1.2)
    assert hot.is_hot and said == [("busy machine: limits grow", {"slack_s": 0.8})]
    hot.passes(0.5)
    assert hot.over and not hot.is_hot
    hot.lab.hurts.clear()  # those of an idle machine, whose limits are shorter


def test_nothing_gets_hotter_by_what_waits_when_the_server_ends(hot):
    hot.ask("set_conditions", HOT, later=True)
    hot.end("the client leaves")
    hot.make_safe()
    hot.obey()
    assert not hot.is_hot
    assert "reopened after a failure" in str(hot.last_error)


def test_a_run_without_a_sign_of_life_makes_safe_a_hot_tube_alone(bench):
    bench.run_hangs_until_s = float("inf")
    bench.passes(3.0)
    assert not bench.all_said(Fault)
    bench.run_hangs_until_s = 0.0
    bench.passes(0.1)
    bench.ask("set_conditions", HOT)
    bench.run_hangs_until_s = float("inf")
    bench.passes(1.0)
    assert bench.is_hot
    bench.passes(0.5)
    assert not bench.is_hot
    assert "must show life every 1.2 s" in str(bench.all_said(Fault)[0].error)


@pytest.mark.parametrize("change", [{"open": (1e6, 10.0)}, {"volts": 850.0}])
def test_what_was_changed_by_hand_is_found_when_it_is_compared(hot, change):
    hot.ask("verify")
    assert hot.last_error is None
    for name, value in change.items():
        setattr(hot.lab, name, value)
    hot.ask("verify")
    assert "must stay as it was set" in str(hot.last_error)
    assert not hot.is_hot


def test_a_gate_opened_by_hand_after_a_failure_is_shut_again(hot):
    hot.lab.supply.line.break_down("mute")
    hot.passes(1.0)
    for _ in range(3):
        hot.lab.open = (1e6, 50.0)
        hot.passes(1.2)
        assert not hot.lab.open[0]
    assert not hot.all_said(MadeSafe)[-1].report.whole
    hot.lab.supply.line.mend()
    hot.passes(1.0)
    assert hot.all_said(MadeSafe)[-1].report.whole


def test_a_slow_supply_delays_no_look_at_the_gate_in_the_opening(bench):
    def slow_prepare(*, limit_v: float) -> None:
        bench.lab.open = (1e6, 50.0)
        bench.passes(0.7)
        open_after.append(bench.lab.open[0])

    open_after = []
    bench.lab.supply.prepare = slow_prepare
    bench.open()
    assert open_after == [0.0]


def test_both_instruments_are_ordered_before_one_of_them_is_asked_in_the_opening(bench):
    bench.lab.volts, bench.lab.open = 650.0, (1e6, 50.0)
    bench.lab.gate.identify = lambda: seen.append((bench.lab.volts, bench.lab.open[0]))
    seen = []
    bench.open()
    assert seen == [(0.0, 0.0)]


def test_a_target_is_placed_before_its_lamp_burns():
    with plant.simulated_time():
        bench = Bench(kind=2)
        bench.ask("shine", 1e-3, point=False, target=Target(), filter_density=None)
        assert "must be placed in the dark before it is lit" in str(bench.last_error)


def test_an_error_of_the_server_itself_makes_safe(hot):
    hot.ask("light_read")  # without its value
    assert "the bench server failed at light_read" in str(hot.last_error)
    assert not hot.is_hot


def test_nobody_waits_for_a_client_that_reads_nothing():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        connection = Connection(ours)
        for _ in range(100_000):
            connection.send(Beat())
            if connection.gone:
                break
        assert connection.gone
        connection.close()


def test_the_last_words_of_a_side_that_leaves_messages_unread_arrive():
    ours, theirs = map(Connection, socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    ours.send(Beat())
    theirs.send(Reply(number=7))
    theirs.close()
    assert [message for message, _ in ours.receive(0.1)] == [Reply(number=7)]
    assert ours.gone
    ours.close()

"""The log gives back what was written, survives a kill, and stays within its bounds."""

import os

import pytest

from common.buslog import BackgroundLog, BusLog, Entry, NoLog, log_files, read_log

ENTRIES = [
    Entry("in", 1, "control/step", b"\x00\xff"),
    Entry("result", 1, "plan", bytes(8)),
    Entry("step", 1, "planner", bytes(8)),
    Entry("out", 2**62, "control/chunk", b""),
]


def write(directory, entries, *, boot=7, name="sim", segment=10**6, keep=10**9):
    log = BusLog(directory, name, boot, segment, keep)
    for entry in entries:
        log.write(entry)
    log.close()


def read_all(directory, name="*"):
    return [entry for path in log_files(directory, name) for entry in read_log(path)]


def test_what_is_written_is_read_back(tmp_path):
    write(tmp_path / "log", ENTRIES)
    assert [path.name for path in log_files(tmp_path / "log")] == ["sim-00000000000000000007-0000.buslog"]
    assert read_all(tmp_path / "log") == ENTRIES


def test_what_is_flushed_survives_a_kill(tmp_path):
    log = BusLog(tmp_path, "sim", 7, 10**6, 10**9)
    log.write(ENTRIES[0])
    log.flush()
    assert read_all(tmp_path) == ENTRIES[:1]
    log.close()


def test_a_log_written_in_the_background_is_the_same_log(tmp_path):
    log = BackgroundLog(BusLog(tmp_path, "sim", 7, 10**6, 10**9))
    for entry in ENTRIES:
        log.write(entry)
        log.flush()
    log.close()
    assert read_all(tmp_path) == ENTRIES


def test_a_background_log_that_cannot_write_says_so_and_raises_nothing():
    class Full(NoLog):
        def write(self, entry):
            raise OSError("disk full")

    log = BackgroundLog(Full())
    log.write(ENTRIES[0])
    log.close()
    assert log.failed == "log ended: disk full"


def test_a_torn_end_loses_only_the_torn_entry(tmp_path):
    write(tmp_path, ENTRIES)
    path = log_files(tmp_path)[0]
    whole = path.read_bytes()
    write(tmp_path / "first", ENTRIES[:3])
    begin = (tmp_path / "first").joinpath(path.name).stat().st_size  # of the last entry
    for size in range(begin, len(whole)):
        path.write_bytes(whole[:size])
        assert list(read_log(path)) == ENTRIES[:3]
    path.write_bytes(whole)
    assert list(read_log(path)) == ENTRIES


@pytest.mark.parametrize(
    "tail",
    [
        b"\xc1",
        b"\x05",
        b"\x94\xa2in\x01\xa1k\xa1x",  # a text where bytes belong
        b"\x94\xa3odd\x01\xa1k\xc4\x00",
        b"\x93\x01\x02\x03",
        b"\x81\x91\x01\x02",
    ],
    ids=bytes.hex,
)
def test_what_is_no_entry_ends_the_log(tmp_path, tail):
    write(tmp_path, ENTRIES)
    path = log_files(tmp_path)[0]
    path.write_bytes(path.read_bytes() + tail + path.read_bytes())
    assert list(read_log(path)) == ENTRIES


def numbered(count, start=0):
    return [Entry("in", start + i, "control/step", bytes(100)) for i in range(count)]


def test_files_are_rotated_and_the_oldest_deleted(tmp_path):
    write(tmp_path, numbered(200), segment=1000, keep=3000)
    sizes = [path.stat().st_size for path in log_files(tmp_path)]
    assert max(sizes) <= 1000
    assert sum(sizes) <= 3000 + 1000
    kept = read_all(tmp_path)
    assert len(kept) >= 20
    assert kept == numbered(200)[-len(kept) :]


def test_an_entry_larger_than_a_file_gets_its_own(tmp_path):
    entries = [ENTRIES[0], Entry("in", 5, "model/snapshot", bytes(5000)), Entry("in", 6, "a", b"")]
    write(tmp_path, entries, segment=1000)
    assert [len(list(read_log(path))) for path in log_files(tmp_path)] == [1, 1, 1]
    assert read_all(tmp_path) == entries


def test_restarting_again_and_again_stays_within_the_bound_too(tmp_path):
    for boot in range(100, 130):
        write(tmp_path, numbered(5, start=boot), boot=boot, segment=1000, keep=3000)
    assert sum(path.stat().st_size for path in log_files(tmp_path)) <= 3000 + 1000
    assert read_all(tmp_path)[-5:] == numbered(5, start=129)


def test_another_process_s_files_are_left_alone(tmp_path):
    write(tmp_path, numbered(10), name="planner")
    write(tmp_path, numbered(200), segment=1000, keep=2000)
    assert read_all(tmp_path, "planner") == numbered(10)


def test_logs_are_listed_in_the_order_in_which_they_were_begun(tmp_path):
    for boot, start in ((900, 10), (5, 50), (300, 90)):
        write(tmp_path, numbered(20, start=start), boot=boot, segment=1500)
    (tmp_path / "sim-00000000000000000001-0000.buslog").touch()  # begun just now
    assert log_files(tmp_path)[-1].stat().st_size == 0
    for path in log_files(tmp_path):
        os.utime(path, (0, 0))  # as after copying
    assert [entry.t_ns for entry in read_all(tmp_path)] == [*range(10, 30), *range(50, 70), *range(90, 110)]


def test_no_log_takes_everything_and_keeps_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = NoLog()
    log.write(ENTRIES[0])
    log.flush()
    log.close()
    assert (log.failed, list(tmp_path.iterdir())) == ("", [])

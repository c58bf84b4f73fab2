"""A step is stored as a whole or not at all: runs that are killed again and again, and files cut at every byte."""

import multiprocessing
import os
import resource
import signal
import time
import warnings

import emcee
import h5py
import numpy as np
import pytest
from toys import banana_run

import streamkit as sk
from streamkit.report import hdf5
from streamkit.sample import ChainFile, blob_dtype, read_chain_file
from streamkit.sample.store import chain_file
from streamkit.sample.store.journal import Journal, journal_of
from streamkit.sample.store.step import Step

SLOW = pytest.mark.slow
PARTS = "chain", "log_prob", "blobs", "accepted", "checksum"


@pytest.fixture(scope="module", params=[40, pytest.param(120, marks=SLOW)])
def steps(request):
    """Steps of the runs that are disturbed: the moves learn their surrogate after 25."""
    return request.param


@pytest.fixture(scope="module")
def whole_file(tmp_path_factory, steps):
    """The file of a run that nobody disturbed."""
    file = ChainFile(tmp_path_factory.mktemp("whole") / "chain.h5")
    banana_run(file, steps, "surrogate")
    return file.path


@pytest.fixture(scope="module")
def whole(whole_file):
    """Its chain."""
    return read_chain_file(whole_file)


def same(found, wanted):
    for name in PARTS:
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    assert found.memory.keys() == wanted.memory.keys()
    for key, values in found.memory.items():
        np.testing.assert_array_equal(values, wanted.memory[key], err_msg=key)
    for one, two in zip(found.random_state, wanted.random_state, strict=True):
        np.testing.assert_array_equal(one, two)
    assert found.attributes["counts"] == wanted.attributes["counts"]


def go_on(path, steps, awake=None):
    """Begin a run of so many steps, or continue it."""
    file = ChainFile(path)
    if path.exists():
        file.load()
    if awake is not None:
        awake.set()
    banana_run(file, steps, "surrogate")


def killed(path, steps, wait):
    """Go on in another process, and kill it after so many seconds."""
    context = multiprocessing.get_context("fork")
    awake = context.Event()
    process = context.Process(target=go_on, args=(path, steps, awake))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of linear algebra
        process.start()
    assert awake.wait(30)
    time.sleep(wait)
    process.kill()
    process.join()
    return process.exitcode == -signal.SIGKILL


def kill_again_and_again(path, steps, tries, seed):
    """Kill a run so many times; the file is readable each time, and never gets shorter."""
    rng, finished = np.random.default_rng(seed), 0
    for number in range(tries):
        # the waits shrink as the chain grows, so that the kills are spread over all of it
        if not killed(path, steps, rng.uniform(0, 0.12) if finished < steps - 20 else rng.uniform(0, 0.01)):
            break
        if path.exists():
            found = len(read_chain_file(path).chain)
            assert found >= finished, number
            finished = found


@pytest.mark.parametrize("tries", [12, pytest.param(50, marks=SLOW)])
def test_a_run_killed_many_times_is_the_run_that_was_not(tmp_path, whole, steps, monkeypatch, tries):
    monkeypatch.setattr(chain_file, "TAIL", 7)
    path = tmp_path / "chain.h5"
    kill_again_and_again(path, steps, tries, 1)
    go_on(path, steps)
    same(read_chain_file(path), whole)
    assert [file.name for file in tmp_path.iterdir()] == ["chain.h5"]


@SLOW
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", range(10))
def test_many_more_kills(tmp_path, whole, steps, monkeypatch, seed):
    monkeypatch.setattr(chain_file, "TAIL", int(2 ** (seed % 5)))
    kill_again_and_again(tmp_path / "chain.h5", steps, 100, 100 + seed)
    go_on(tmp_path / "chain.h5", steps)
    same(read_chain_file(tmp_path / "chain.h5"), whole)


@pytest.mark.parametrize("call", [pytest.param("fsync", marks=SLOW), "replace"])
def test_a_death_at_any_call_to_the_system_costs_nothing(tmp_path, whole, steps, monkeypatch, call):
    """The process dies at every such call of a stretch of the run, once each."""
    monkeypatch.setattr(chain_file, "TAIL", 3)
    path, original, context = tmp_path / "chain.h5", getattr(os, call), multiprocessing.get_context("fork")

    def run(deadly):
        left = [deadly]

        def die(*args, **options):
            left[0] -= 1
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*args, **options)

        setattr(os, call, die)
        go_on(path, steps)

    for deadly in range(1, 6):
        process = context.Process(target=run, args=(deadly,))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
    go_on(path, steps)
    same(read_chain_file(path), whole)


ROOMS = [3_000, 60_000, *(pytest.param(room, marks=SLOW) for room in (30_000, 100_000, 200_000))]


@pytest.mark.parametrize("room", ROOMS)
def test_a_full_disk_ends_in_a_sentence_and_costs_no_step(tmp_path, whole, steps, monkeypatch, room):
    """No file may grow beyond so many bytes; when there is room again the run goes on as if nothing had been."""
    monkeypatch.setattr(chain_file, "TAIL", 9)
    path, context = tmp_path / "chain.h5", multiprocessing.get_context("fork")
    told = context.SimpleQueue()

    def run():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        try:
            go_on(path, steps)
        except sk.ChainError as error:
            told.put(str(error))

    process = context.Process(target=run)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    process.join()
    assert process.exitcode == 0
    assert not told.empty()
    assert "cannot be written (File too large)" in told.get()
    if path.exists():
        assert len(read_chain_file(path).chain) > 5 or room < 60_000
    go_on(path, steps)
    same(read_chain_file(path), whole)


def test_a_journal_cut_at_any_byte_keeps_the_records_before(tmp_path):
    journal = Journal(tmp_path / "chain.journal")
    ends = [0]
    for number in range(3):
        journal.append({"x": np.arange(number + 1.0)})
        ends.append(journal.path.stat().st_size)
    data = journal.path.read_bytes()
    for cut in range(0, len(data) + 1, 5):
        journal.path.write_bytes(data[:cut])
        mine = Journal(journal.path)
        found = mine.read()
        assert len(found) == sum(end <= cut for end in ends[1:])
        mine.append({"x": np.array([7.0])})
        assert [record["x"][-1] for record in Journal(journal.path).read()] == [*range(len(found)), 7.0]


@pytest.mark.parametrize("left", [None, 0, 300])
def test_a_journal_taken_away_during_the_run_is_told_and_its_steps_are_kept(tmp_path, left):
    """What is in memory goes into the chain file when the run ends."""
    path = tmp_path / "chain.h5"
    file = ChainFile(path)
    append = file.append

    def disturbed(step):
        if file.iteration == 12:
            journal = journal_of(path).path
            journal.unlink() if left is None else journal.write_bytes(journal.read_bytes()[:left])
        append(step)

    file.append = disturbed
    with pytest.raises(sk.ChainError, match=r"chain\.journal: was removed or cut by somebody else"):
        banana_run(file, 30, "de")
    assert len(read_chain_file(path).chain) == 12


def test_a_run_that_was_killed_misses_its_journal(tmp_path, monkeypatch):
    monkeypatch.setattr(chain_file, "TAIL", 7)
    path = tmp_path / "chain.h5"
    file, consolidate = ChainFile(path), ChainFile.consolidate
    with monkeypatch.context() as patch:  # the end does not come
        patch.setattr(ChainFile, "consolidate", lambda self, goes_on=False: goes_on and consolidate(self, goes_on))
        banana_run(file, 10, "de")
    whole = read_chain_file(path)
    assert (len(whole.chain), whole.lacks_journal) == (10, False)
    journal = journal_of(path).path
    content = journal.read_bytes()
    for left in (b"", None):
        journal.unlink() if left is None else journal.write_bytes(left)
        cut = read_chain_file(path)
        assert (len(cut.chain), cut.lacks_journal) == (7, True)
    journal.write_bytes(content)
    file = ChainFile(path)
    file.load()
    file.consolidate()
    whole = read_chain_file(path)
    assert (len(whole.chain), whole.lacks_journal, journal.exists()) == (10, False, False)


def test_a_damaged_journal_is_told_from_one_that_was_cut(tmp_path):
    journal = Journal(tmp_path / "chain.journal")
    for number in range(3):
        journal.append({"x": np.full(5, float(number))})
    data = bytearray(journal.path.read_bytes())
    data[200] ^= 1
    journal.path.write_bytes(data)
    with pytest.raises(sk.ChainError, match="damaged at byte 20"):
        Journal(journal.path).read()
    journal.path.write_bytes(b"hello")
    with pytest.raises(sk.ChainError, match="not a journal"):
        Journal(journal.path).read()


def test_a_flipped_bit_anywhere_in_a_journal_drops_at_most_its_last_record(tmp_path):
    """Lengths, checksums and bodies of all records: each bit of the heads, and some of the bodies."""
    journal = Journal(tmp_path / "chain.journal")
    ends = [0]
    for number in range(5):
        journal.append({"x": np.full(3, float(number))})
        ends.append(journal.path.stat().st_size)
    data = journal.path.read_bytes()
    begins = [20, *ends[1:-1]]
    heads = [8 * (begin + byte) + bit for begin in begins for byte in range(24) for bit in range(8)]
    for place in [*heads, *range(160, 8 * len(data), 61)]:
        damaged = bytearray(data)
        damaged[place // 8] ^= 1 << place % 8
        journal.path.write_bytes(damaged)
        mine = Journal(journal.path)
        if place // 8 < begins[-1]:
            with pytest.raises(sk.ChainError, match="is damaged at byte"):
                mine.read()
            continue
        try:
            found = mine.read()
        except sk.ChainError:
            continue  # its length was shown to be wrong
        assert [record["x"][0] for record in found] == [0.0, 1.0, 2.0, 3.0]
        assert mine.torn == ends[-1] - ends[-2]


def test_a_resumed_run_says_which_step_was_torn(tmp_path, whole, steps, caplog):
    path = tmp_path / "chain.h5"
    file = ChainFile(path)
    file.consolidate = lambda goes_on=False: None  # as if it had been killed
    banana_run(file, 20, "surrogate")
    assert not caplog.text
    journal = journal_of(path).path
    journal.write_bytes(journal.read_bytes()[:-30])
    resumed = ChainFile(path)
    resumed.load()
    assert resumed.iteration == 19
    assert "chain.journal: ends with a part of step 20 (" in caplog.text
    assert "the run continues after step 19." in caplog.text
    go_on(path, steps)
    same(read_chain_file(path), whole)


def test_a_chain_file_that_cannot_be_read_is_rebuilt_as_long_as_the_journal_holds_all(tmp_path, whole, steps):
    path = tmp_path / "chain.h5"
    file = ChainFile(path)
    file.consolidate = lambda goes_on=False: None  # as if it had been killed
    banana_run(file, 30, "surrogate")
    path.write_bytes(path.read_bytes()[:1000])
    assert len(read_chain_file(path).chain) == 30
    go_on(path, steps)
    same(read_chain_file(path), whole)


def test_emcee_reads_the_file_of_a_finished_run(whole_file, whole, steps):
    reader = emcee.backends.HDFBackend(str(whole_file), read_only=True)
    np.testing.assert_array_equal(reader.get_chain(), whole.chain)
    np.testing.assert_array_equal(reader.get_blobs(), whole.blobs)
    assert reader.iteration == steps
    mine = ChainFile(whole_file)
    mine.load()
    np.testing.assert_array_equal(mine.samples(), reader.get_chain())


def test_flipped_bits_anywhere_are_refused(tmp_path):
    path, rng = tmp_path / "chain.h5", np.random.default_rng(5)
    banana_run(ChainFile(path), 20, "surrogate")
    content = path.read_bytes()
    for place in [*rng.integers(len(content), size=150), *rng.integers(4096, size=50)]:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(sk.ChainError) as caught:
            read_chain_file(path)
        assert len(str(caught.value).splitlines()) == 1


def test_a_file_in_which_hdf5_never_ends_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5, "SECONDS", 0.2)

    def endless(file):
        while True:
            pass

    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(hdf5.DamagedError, match="does not end"):
        hdf5.read_foreign(tmp_path / "x.h5", endless)


def test_a_journal_of_another_run_is_refused(tmp_path, monkeypatch):
    one, two = tmp_path / "one.h5", tmp_path / "two.h5"
    for path, moves in ((one, "stretch"), (two, "de")):
        file = ChainFile(path)
        banana_run(file, 30, moves)
        file.load()
        file.consolidate = lambda goes_on=False: None
        banana_run(file, 32, moves)
    journal_of(two).path.replace(journal_of(one).path)
    with pytest.raises(sk.ChainError, match=r"does not continue one\.h5, of 30 steps"):
        ChainFile(one).load()


def test_nothing_is_written_through_a_link_in_place_of_a_journal(tmp_path):
    (tmp_path / "mine").touch()
    journal = Journal(tmp_path / "chain.journal")
    for target in ("mine", "missing"):
        journal.path.unlink(missing_ok=True)
        journal.path.symlink_to(tmp_path / target)
        with pytest.raises(sk.ChainError, match=r"chain\.journal: is a link"):
            Journal(journal.path).append({"x": np.zeros(1)})
    assert (tmp_path / "mine").read_bytes() == b""
    assert not (tmp_path / "missing").exists()


def test_a_journal_that_is_cleared_while_it_is_looked_at_is_no_device(tmp_path, monkeypatch):
    """Another process reads the status of a run that has just moved the steps into the chain file."""
    journal, look = Journal(tmp_path / "chain.journal"), os.stat
    journal.append({"x": np.zeros(1)})

    def last_look(*args, **options):
        result = look(*args, **options)
        journal.path.unlink(missing_ok=True)
        return result

    monkeypatch.setattr(os, "stat", last_look)
    assert Journal(journal.path).read() == []


def test_samples_that_repeat_take_little_room(tmp_path):
    """One proposal in four is accepted: with each other sample go the 200 numbers that were predicted before."""
    rng, walkers, m = np.random.default_rng(6), 16, 100
    file = ChainFile(tmp_path / "chain.h5")
    file.reset(walkers, 2)
    blobs = np.zeros(walkers, dtype=blob_dtype(m))
    random_state = np.random.RandomState(1).get_state()
    for number in range(151):
        accepted = rng.random(walkers) < 0.25
        blobs = blobs.copy()
        for name in ("mean", "variance"):
            blobs[name][accepted] = rng.random((accepted.sum(), m))
        file.append(Step(number, rng.random((walkers, 2)), rng.random(walkers), blobs, accepted, random_state))
    file.consolidate()
    assert file.path.stat().st_size < 0.5 * (150 * walkers * 2 * m * 8)
    stored = read_chain_file(file.path)
    np.testing.assert_array_equal(stored.blobs[-1], blobs)
    backend = emcee.backends.HDFBackend(str(file.path), read_only=True)
    np.testing.assert_array_equal(backend.get_chain(), stored.chain)

"""A file that can be cut off anywhere: what is whole in it is read, by us and by the MCAP library."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from deploy.record.container import McapFile, NotARecordingError, messages_of, scan

SCHEMA = json.dumps({"type": "object"}).encode()


def write(path: Path, chunks: int, each: int = 4) -> McapFile:
    """A file with so many chunks, not finished."""
    file = McapFile(path)
    file.add_metadata("about", {"seed": "3"})
    channel = file.channel("/count", "count", SCHEMA)
    for k in range(chunks * each):
        file.add(channel, k, k, json.dumps({"n": k}).encode())
        if k % each == each - 1:
            file.cut()
    return file


def numbers(path: Path) -> list[int]:
    """What we read."""
    with path.open("rb") as file:
        return [json.loads(data)["n"] for part in scan(file).parts for *_, data in messages_of(part, file)]


def numbers_of_the_library(data: bytes) -> list[int]:
    """What the library reads, record by record, as far as there is something."""
    found: list[int] = []
    with suppress(EndOfFile):
        records = StreamReader(io.BytesIO(data)).records
        found.extend(json.loads(record.data)["n"] for record in records if isinstance(record, Message))
    return found


def test_a_finished_file_is_read_by_the_library_by_its_index(tmp_path):
    path = tmp_path / "a.mcap"
    write(path, chunks=3).finish()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert [json.loads(m.data)["n"] for _, _, m in reader.iter_messages(starting_at=5)] == list(range(5, 12))
        assert (summary.statistics.message_count, len(summary.chunk_indexes)) == (12, 3)
        assert [record.metadata for record in reader.iter_metadata()] == [{"seed": "3"}]
    assert numbers(path) == list(range(12))


def test_a_file_cut_off_at_any_byte_is_read_to_its_last_whole_chunk_and_continued(tmp_path):
    path, cut_off = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write(path, chunks=3).finish()
    whole = path.read_bytes()
    with path.open("rb") as file:
        ends = [
            p.index.chunk_start_offset + p.index.chunk_length + p.index.message_index_length for p in scan(file).parts
        ]
    for length in range(9, len(whole), 7):
        cut_off.write_bytes(whole[:length])
        left = 4 * sum(length >= end for end in ends)
        assert numbers(cut_off) == list(range(left))
        again = McapFile(cut_off)
        channel = again.channel("/count", "count", SCHEMA)
        again.add(channel, 99, 99, b'{"n":99}')
        again.finish()
        with cut_off.open("rb") as file:
            read = [json.loads(m.data)["n"] for _, _, m in make_reader(file, validate_crcs=True).iter_messages()]
        assert read == [*range(left), 99]


def test_an_unfinished_file_is_read_by_the_library_in_a_stream(tmp_path):
    path = tmp_path / "a.mcap"
    write(path, chunks=2).close()
    assert numbers_of_the_library(path.read_bytes()) == list(range(8))


FILL = """
import resource, sys
from pathlib import Path
from deploy.record.container import McapFile
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
file = McapFile(Path(sys.argv[1]))
channel = file.channel("/count", "count", b'{"type": "object"}')
written = 0
try:
    for k in range(10_000):
        file.add(channel, k, k, b'{"n":%d}' % k)
        if k % 100 == 99:
            file.cut()
            written = k
except OSError:
    file.finish()
    print(written)
"""


def test_when_the_disk_is_full_the_file_is_finished_with_what_fits(tmp_path):
    path = tmp_path / "a.mcap"
    told = subprocess.run([sys.executable, "-c", FILL, str(path)], capture_output=True, text=True, check=True)
    with path.open("rb") as file:
        read = [json.loads(m.data)["n"] for _, _, m in make_reader(file, validate_crcs=True).iter_messages()]
    assert read == list(range(len(read)))
    assert int(told.stdout) - 2000 < len(read) <= int(told.stdout) + 1


def test_something_else_is_no_recording_and_stays_as_it_is(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"my diary, not a recording")
    with pytest.raises(NotARecordingError, match=r"a\.mcap"):
        McapFile(path)
    assert path.read_bytes() == b"my diary, not a recording"


def test_nobody_else_writes_a_file_that_is_being_written(tmp_path):
    file = write(tmp_path / "a.mcap", chunks=1)
    with pytest.raises(BlockingIOError):
        McapFile(tmp_path / "a.mcap")
    file.finish()

"""MCAP files that are written are those of the mcap package's readers, checksums and indexes included."""

from collections import Counter
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viewshed.recordings.read.bag_files import open_bag
from viewshed.recordings.write.bag_writers import Schema, open_bag_writer

pytest.importorskip("lz4", reason="lz4 is not installed: MCAP is not written")
reader: Any = pytest.importorskip("mcap.reader", reason="mcap is not installed: its files are not read back")

TOPICS = {"/tf": "Pose", "/points": "Cloud", "/more": "Cloud"}
MESSAGES = st.lists(
    st.tuples(st.sampled_from(sorted(TOPICS)), st.integers(0, 2**62), st.binary(max_size=40), st.integers(1, 40_000)),
    max_size=30,
)


def written(messages: list[tuple[str, int, bytes]]) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        schemas = {name: Schema(name, "ros2msg", "cdr", name.encode()) for name in ("Pose", "Cloud")}
        with open_bag_writer(path) as bag:
            for topic, t_ns, data in messages:
                bag.write(topic, schemas[TOPICS[topic]], t_ns, data, latched=topic == "/tf")
        return path.read_bytes()


@settings(max_examples=25)
@given(MESSAGES)
def test_others_read_what_was_written(drawn: list[tuple[str, int, bytes, int]]) -> None:
    # Data of up to 1.6 MB, so that chunks end between messages.
    messages = [(topic, t_ns, data * times) for topic, t_ns, data, times in drawn]
    content = written(messages)
    # 1. From the beginning to the end, without the summary.
    stream = reader.NonSeekingReader(BytesIO(content), validate_crcs=True)
    found = [
        (channel.topic, message.log_time, message.data, schema.name, bool(channel.metadata["offered_qos_profiles"]))
        for schema, channel, message in stream.iter_messages(log_time_order=False)
    ]
    assert found == [(topic, t_ns, data, TOPICS[topic], topic == "/tf") for topic, t_ns, data in messages]
    # 2. By the summary and the indexes: each topic by itself, in the order of time.
    seeking = reader.SeekingReader(BytesIO(content), validate_crcs=True)
    summary = seeking.get_summary()
    names = {number: channel.topic for number, channel in summary.channels.items()}
    counts = {names[number]: count for number, count in summary.statistics.channel_message_counts.items()}
    assert counts == Counter(topic for topic, _, _ in messages)
    assert summary.statistics.message_count == len(messages)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    if messages:
        times = [t_ns for _, t_ns, _ in messages]
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (min(times), max(times))
    for topic in counts:
        by_index = [(each.log_time, each.data) for _, _, each in seeking.iter_messages(topics=[topic])]
        of_topic = [(t_ns, data) for name, t_ns, data in messages if name == topic]
        assert sorted(by_index) == sorted(of_topic)
        assert [t_ns for t_ns, _ in by_index] == sorted(t_ns for t_ns, _ in of_topic)


def test_long_files_have_many_chunks_and_equal_bytes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    messages = [("/points", number, rng.bytes(300_000) + bytes(100_000)) for number in range(10)]
    content = written(messages)
    assert content == written(messages)
    summary = reader.SeekingReader(BytesIO(content)).get_summary()
    assert [index.message_start_time for index in summary.chunk_indexes] == [0, 3, 6, 9]
    assert all(index.compressed_size < 0.8 * index.uncompressed_size for index in summary.chunk_indexes)
    (tmp_path / "a.mcap").write_bytes(content)
    bag = open_bag(tmp_path, tmp_path / "a.mcap")
    assert [(each.topic, each.t_ns, each.raw) for each in bag.messages(("Cloud",))] == messages
    bag.close()

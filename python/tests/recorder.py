"""Records a log again in real time: `recorder.py LOG OUT SPEED [STOP]`. Terminates without closing the file
after STOP seconds."""

import os
import sys
import time
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer


def record(log: Path, out: Path, speed: float, stop: float) -> None:
    channels: dict[int, int] = {}
    with log.open("rb") as source, out.open("wb") as sink:
        writer = Writer(sink, chunk_size=1 << 14)
        writer.start()
        started, first = time.monotonic(), 0
        for schema, channel, message in make_reader(source).iter_messages():
            first = first or message.log_time
            at = (message.log_time - first) / 1e9
            if at > stop:
                sink.flush()
                os._exit(9)
            wait = at / speed - (time.monotonic() - started)
            if wait > 0:
                sink.flush()
                time.sleep(wait)
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, dict(channel.metadata)
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()


if __name__ == "__main__":
    log, out, speed, *stop = sys.argv[1:]
    record(Path(log), Path(out), float(speed), float(stop[0]) if stop else float("inf"))

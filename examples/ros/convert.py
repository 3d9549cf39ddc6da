"""Convert recordings and plans to Parquet or MCAP, and logs in Parquet or MCAP to CSV.

python examples/ros/convert.py recording.csv -o recording.parquet  # or .mcap
python examples/ros/convert.py bag.mcap -o log.csv                 # for soft-limb import log.csv
"""

import argparse
import dataclasses
import io
import json
import math
import sys
from pathlib import Path

import pandas
import pyarrow
import pyarrow.parquet
from mcap.reader import make_reader
from mcap.writer import Writer

from limb_systems.errors import LimbError
from limb_systems.files.output import check_outputs, write_atomically
from limb_systems.summary import Summary
from soft_limb.command import run_words
from soft_limb.commands.options import Command, Option, print_summary, shared
from soft_limb.results.read_result import GAIT, RECORDING, TRAJECTORY, read_result

METADATA = "soft_limb"  # name of the metadata of a whole file
FLOATS = "std_msgs/msg/Float64MultiArray"  # as a bag of ROS 2 names it
UNITS = {"s": "s", "c": "°C", "m": "m", "n": "N", "deg": "°"}  # by the ends of columns' names


def to_pandas(samples) -> pandas.DataFrame:
    """Return the table of a recording, plan or gait: a row per sample, indexed by time in s.

    The columns are as in the CSV file, with angles in degrees. ``attrs`` have the kind, the unit of
    each column, the provenance, and the source of a recording or the check of a plan.
    """
    text = io.StringIO(samples.to_text())
    frame = pandas.read_csv(text, comment="#", index_col="time_s")
    frame.attrs = {
        "kind": samples.KIND,
        "units": {name: unit_of(name) for name in ("time_s", *frame)},
        "provenance": samples.provenance and dataclasses.asdict(samples.provenance),
    }
    for name in ("source", "interrupted", "check"):
        value = getattr(samples, name, None)
        if value is not None:
            is_record = dataclasses.is_dataclass(value)
            frame.attrs[name] = dataclasses.asdict(value) if is_record else value
    return frame


def unit_of(column: str) -> str:
    """Return the unit of a column of the CSV format, by the end of its name."""
    if column.startswith(("duty_", "applied_duty_")):
        return "1"
    if column.endswith("_deg_s"):
        return "°/s"
    return "" if column.startswith("wire_state_") else UNITS.get(column.rpartition("_")[2], "")


def write_parquet(samples, path: Path) -> None:
    """Write the columns of `to_pandas` as doubles, with units and ``attrs`` in the metadata.

    The metadata of a column have its ``unit``. Those of the file have under ``soft_limb``, as JSON,
    ``attrs`` and the parameters of the limb in YAML. pandas reads ``attrs``.
    """
    frame = to_pandas(samples)
    frame.attrs = without_nan(frame.attrs)
    table = pyarrow.Table.from_pandas(frame)
    units = frame.attrs["units"]
    fields = [field.with_metadata({"unit": units[field.name]}) for field in table.schema]
    about = json.dumps(about_of(samples, frame), ensure_ascii=False)
    schema = pyarrow.schema(fields).with_metadata({**table.schema.metadata, METADATA: about})
    # Write the table to memory first, so that no half-written file is left.
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table.cast(schema), buffer)
    write_atomically(path, buffer.getvalue())


def write_mcap(samples, path: Path) -> None:
    """Write a channel of JSON for each signal, with the signal's columns.

    The topic is the signal's name, such as ``/duty``. Log times are ns since time zero; each
    message has ``time_s`` as well, which is exact. The schema of a channel describes each column by
    its unit. The metadata ``soft_limb`` are written as by `write_parquet`.
    """
    frame = to_pandas(samples)
    units = frame.attrs["units"]
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start(library="soft-limb")
    # Register a channel with a schema for each signal.
    channels = []
    for signal, names in samples.columns_of(samples.parameters, samples.robot).items():
        present = [name for name in names if name in frame]
        if not present:
            continue
        numbers = {}
        for name in ("time_s", *present):
            numbers[name] = {"type": "number", "description": units[name]}
        schema = {"title": signal, "type": "object", "properties": numbers}
        identity = writer.register_schema(
            f"soft_limb.{signal}", "jsonschema", json.dumps(schema, ensure_ascii=False).encode()
        )
        channel = writer.register_channel(f"/{signal}", "json", identity)
        channels.append((channel, present, frame[present].to_numpy().tolist()))
    # Write a message of each channel for each sample.
    for index, time in enumerate(frame.index.tolist()):
        at = round(time * 1e9)
        for channel, names, rows in channels:
            # JSON has no NaN: a reading that is missing is not in the message.
            message = {"time_s": time}
            for name, value in zip(names, rows[index], strict=True):
                if not math.isnan(value):
                    message[name] = value
            writer.add_message(channel, at, json.dumps(message).encode(), at, sequence=index)
    # Write the metadata of the file.
    texts = {}
    for name, value in without_nan(about_of(samples, frame)).items():
        is_text = isinstance(value, str)
        texts[name] = value if is_text else json.dumps(value, ensure_ascii=False)
    writer.add_metadata(METADATA, texts)
    writer.finish()
    write_atomically(path, buffer.getvalue())


def about_of(samples, frame) -> dict:
    """Return the metadata of a file: ``attrs``, and the parameters in YAML."""
    return {**frame.attrs, "parameters": (samples.robot or samples.parameters).to_yaml()}


def without_nan(value):
    """Replace NaN in a value by None, as JSON has no NaN; a plan without a check has some."""
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_parquet(path: Path) -> pandas.DataFrame:
    """Return the columns of a Parquet file, its index as the first one if the index has a name."""
    frame = pandas.read_parquet(path)
    return frame.reset_index() if frame.index.name else frame


def read_mcap(path: Path) -> pandas.DataFrame:
    """Return the numbers in the messages of an MCAP file, a row for each time.

    A cell is empty if no message of that time has the number. Messages may be objects of JSON, or
    `FLOATS` of ROS 2. The numbers of `FLOATS` get their names from the label of their dimension, as
    the bridge writes it, or else from their topic. ``time_s`` is the time in the messages if all
    have one, else s since the first message was logged.
    """
    # Read all numbers with their log times.
    messages = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                content = json.loads(message.data)
            elif schema and schema.name == FLOATS:
                content = floats_of(message.data, channel.topic.strip("/").replace("/", "_"))
            else:
                continue
            numbers = {}
            for name, value in content.items():
                if isinstance(value, int | float):
                    numbers[name] = value
            messages.append((message.log_time, numbers))
    if not messages:
        raise LimbError(f"{path} has no messages of JSON or of {FLOATS}.")
    # Join the numbers of each time to a row.
    start = messages[0][0]
    rows = {}
    have_time = all("time_s" in numbers for _, numbers in messages)
    for logged, numbers in messages:
        time = numbers["time_s"] if have_time else (logged - start) * 1e-9
        rows.setdefault(time, {"time_s": time}).update(numbers | {"time_s": time})
    return pandas.DataFrame(map(rows.get, sorted(rows)))


def floats_of(data: bytes, topic: str) -> dict[str, float]:
    """Return the numbers in a message of `FLOATS` by their names."""
    from ros_bridge.dds import Float64MultiArray

    message = Float64MultiArray.__idl__.deserialize(data)
    names = message.layout.dim[0].label.split(",") if message.layout.dim else []
    if len(names) != len(message.data):
        names = [f"{topic}_{number}" for number in range(len(message.data))]
    return dict(zip(names, message.data, strict=True))


READERS = {".parquet": read_parquet, ".mcap": read_mcap}
WRITERS = {".parquet": write_parquet, ".mcap": write_mcap}


def convert(options: argparse.Namespace) -> int:
    """Convert each file to the format of ``--format``, or of the output's name."""
    # Name the outputs, and check all before the first is written.
    is_single = len(options.files) == 1
    suffix = options.output.suffix if is_single else ".parquet"
    if options.format:
        suffix = f".{options.format}"
    outputs = [options.output]
    if not is_single:
        outputs = [options.output / f"{path.stem}{suffix}" for path in options.files]
    check_outputs(outputs, inputs=options.files, force=options.force)
    # Convert one file after the other.
    for path, output in zip(options.files, outputs, strict=True):
        if suffix in WRITERS:
            result = read_result(path)
            if result.kind not in (RECORDING, TRAJECTORY, GAIT):
                raise LimbError(f"{path} is a {result.kind}, which has no samples to convert.")
            WRITERS[suffix](result.value, output)
        elif suffix == ".csv" and path.suffix in READERS:
            frame = READERS[path.suffix](path)
            write_atomically(output, frame.to_csv(index=False))
        else:
            raise LimbError(
                f"{path} cannot become {output}: a recording or plan (.csv) becomes "
                f"{' or '.join(WRITERS)}, and those become .csv."
            )
    print_summary(options, Summary([]), outputs)
    return 0


COMMAND = Command(
    convert,
    "Convert recordings, plans and gaits to Parquet, for tables, or to MCAP, for viewers of robot "
    "logs, with units and provenance in the metadata. Convert a log in Parquet or MCAP to a CSV "
    "for soft-limb import.",
    "force",
    [
        Option("files", nargs="+", metavar="FILE", type=Path, help=".csv, .parquet or .mcap"),
        shared("output", help="file to write; the folder to write to if there are several"),
        Option(
            "--format",
            choices=["parquet", "mcap", "csv"],
            help="format to write; if left out, the end of the output's name tells it; parquet for "
            "several files",
        ),
    ],
    stopped="stopped; no file is half-written",
    examples=["python examples/ros/convert.py out/recording.csv -o out/recording.mcap"],
)

if __name__ == "__main__":
    sys.exit(run_words(COMMAND, "convert.py", sys.argv[1:]))

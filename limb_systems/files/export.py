"""Recordings and trajectories for other tools: Parquet, MCAP.

The packages for these are an extra of soft-limb. Nothing reads these files back: the CSV
is what counts.
"""

import io
import json
import math
from pathlib import Path
from typing import Any

from limb_systems.files.samples import Samples, import_extra
from limb_systems.output import write_atomically

METADATA = "soft_limb"  # name of what is about the whole file


def write_parquet(samples: Samples, path: str | Path) -> None:
    """Writes a Parquet file: the columns of `to_pandas`, as doubles.

    Each column's metadata have its ``unit``, and those of the file under ``soft_limb``
    as JSON what ``attrs`` have and the limb's parameters in YAML. pandas reads ``attrs``.

    Raises:
        LimbError: if pandas or pyarrow is not installed.
    """
    frame = samples.to_pandas()
    frame.attrs = _without_nan(frame.attrs)
    arrow, parquet = import_extra("pyarrow"), import_extra("pyarrow.parquet")
    table = arrow.Table.from_pandas(frame)
    units = frame.attrs["units"]
    schema = arrow.schema(
        [field.with_metadata({"unit": units[field.name]}) for field in table.schema]
    )
    about = json.dumps(_about(samples, frame), ensure_ascii=False)
    schema = schema.with_metadata({**table.schema.metadata, METADATA: about})
    buffer = io.BytesIO()
    parquet.write_table(table.cast(schema), buffer)
    write_atomically(path, buffer.getvalue())


def write_mcap(samples: Samples, path: str | Path) -> None:
    """Writes an MCAP file: for each signal a channel of JSON with its columns.

    The topic is the signal's name, such as ``/duty``. Log times are ns since time zero;
    each message has ``time_s`` as well, which is exact. The schema of a channel describes
    each column by its unit, and the metadata ``soft_limb`` are those of `write_parquet`.

    Raises:
        LimbError: if pandas or mcap is not installed.
    """
    frame = samples.to_pandas()
    writers = import_extra("mcap.writer")
    units, times = frame.attrs["units"], frame.index.to_numpy()
    buffer = io.BytesIO()
    writer = writers.Writer(buffer)
    writer.start(library="soft-limb")
    channels = []
    for signal, names in samples.columns_of(samples.parameters, samples.robot).items():
        present = [name for name in names if name in frame]
        if not present:
            continue
        schema = {
            "title": signal,
            "type": "object",
            "properties": {
                name: {"type": "number", "description": units[name]}
                for name in ["time_s", *present]
            },
        }
        identity = writer.register_schema(
            f"soft_limb.{signal}", "jsonschema", json.dumps(schema, ensure_ascii=False).encode()
        )
        channel = writer.register_channel(f"/{signal}", "json", identity)
        channels.append((channel, present, frame[present].to_numpy().tolist()))
    for index, time in enumerate(times.tolist()):
        at = round(time * 1e9)
        for channel, names, rows in channels:
            values = zip(names, rows[index], strict=True)
            # JSON has no nan: readings that are missing are not in the message.
            message = {"time_s": time, **{n: v for n, v in values if not math.isnan(v)}}
            writer.add_message(channel, at, json.dumps(message).encode(), at, sequence=index)
    about = _without_nan(_about(samples, frame))
    writer.add_metadata(
        METADATA,
        {
            name: value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            for name, value in about.items()
        },
    )
    writer.finish()
    write_atomically(path, buffer.getvalue())


def _about(samples: Samples, frame: Any) -> dict[str, Any]:
    described = samples.robot or samples.parameters
    return {**frame.attrs, "parameters": described.to_yaml()}


def _without_nan(value: Any) -> Any:
    """For JSON, which has no NaN: the check of a plan that was never checked has them."""
    if isinstance(value, dict):
        return {name: _without_nan(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

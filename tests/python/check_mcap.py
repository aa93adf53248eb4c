"""Reads a run with the public MCAP library and each channel's own protobuf schema; prints what is in it as JSON.

    check_mcap.py RUN.mcap
"""

import json
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

path = sys.argv[1]
out = {"topics": {}, "failures": []}
with open(path, "rb") as stream:
    # validate_crcs: every chunk's and the file's check sums are recomputed.
    reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    out["profile"] = reader.get_header().profile
    out["schemas"] = sorted({(s.name, s.encoding) for s in summary.schemas.values()})
    out["attachments"] = sorted(a.name for a in reader.iter_attachments())
    out["metadata"] = sorted({m.name for m in reader.iter_metadata()})
    out["messages"] = summary.statistics.message_count
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        topic = out["topics"].setdefault(
            channel.topic, {"schema": schema.name, "messages": 0, "points": 0}
        )
        topic["messages"] += 1
        if schema.name == "foxglove.PointCloud":
            fields = {f.name: (f.offset, f.type) for f in decoded.fields}
            # 7 is FLOAT32 in foxglove.PackedElementField.NumericType.
            for name in ("x", "y", "z"):
                if fields.get(name, (0, 0))[1] != 7:
                    out["failures"].append(f"{channel.topic}: no float {name}")
            if len(decoded.data) % decoded.point_stride:
                out["failures"].append(f"{channel.topic}: ragged data")
            count = len(decoded.data) // decoded.point_stride
            topic["points"] += count
            topic["fields"] = [f.name for f in decoded.fields]
            topic["frame"] = decoded.frame_id
            for k in range(count):
                x = struct.unpack_from("<3f", decoded.data, k * decoded.point_stride)
                # Metres, within the reach of a hand.
                if not all(abs(c) < 2.0 for c in x):
                    out["failures"].append(f"{channel.topic}: a point at {x}")
                    break
print(json.dumps(out))

"""VlaResponse.msg as a bag holds it, decoded without ROS."""

from __future__ import annotations

import json
from typing import Any

from ssp_core.cdr.messages import stamp_ns
from ssp_vla_bridge.core.response import NativeArray, Response

RESPONSE_TYPE = "ssp_msgs/msg/VlaResponse"


def response_of_message(message: Any) -> Response:
    """The response in a decoded message (ssp_core.bag.BagReader.decode).

    Raises:
        ValueError: its decoding facts are no JSON object.
    """
    decoding = json.loads(message.decoding) if message.decoding else {}
    if not isinstance(decoding, dict):
        raise ValueError(f"decoding must be a JSON object, got {message.decoding[:100]!r}")
    return Response(
        request_id=str(message.request_id),
        stamp_ns=stamp_ns(message.header.stamp),
        model=str(message.model),
        model_id=str(message.model_id),
        text=str(message.text),
        arrays=tuple(
            NativeArray(
                name=str(one.name),
                shape=tuple(int(size) for size in one.shape),
                data=tuple(float(value) for value in one.data),
                frame=str(one.frame),
                unit=str(one.unit),
                step_s=float(one.step),
                first_time_s=float(one.first_time),
            )
            for one in message.arrays
        ),
        decoding=decoding,
        latency_s=float(message.latency),
        error_code=int(message.error_code),
        error_msg=str(message.error_msg),
    )

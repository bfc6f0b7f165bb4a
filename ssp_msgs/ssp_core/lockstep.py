"""What nodes agree on in lockstep, so that nobody is run away from.

A publisher keeps its last 50 messages for a reader that is behind (QoS STATE), and no topic has
more than one or two of them a step. A recorder that the machine starves would lose older ones. So
it says how far it is, and the world doesn't run further ahead than that.
"""

from __future__ import annotations

# The recorder answers every tick whose number this divides, once it has taken it.
RECORDER_STEPS = 5
# The world waits when the recorder's last answer is older than this.
RECORDER_LAG_STEPS = 20

"""A robot side on the DDS version that the real robot runs (Cyclone 0.10), to see that ours does not break it.

Runs under a Python that has `cyclonedds==0.10.2` (wheels exist up to Python 3.10) and nothing of this project:
the types are read from `hal/unitree/idl.py` with every octet declared as the vendor's SDK does, `uint8`.

    python3.10 tests/hal/unitree/old_peer.py DOMAIN TICK MODE BODY_HEIGHT

It publishes LowState and sportmodestate, answers every request with code 0, and prints one line per request.
"""

import importlib.util
import pathlib
import select
import struct
import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

ROOT = pathlib.Path(__file__).parents[3] / "hal" / "unitree"
CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


def load(name, edit=lambda text: text):
    """A module of the project by its text: the package itself needs a newer Python."""
    spec = importlib.util.spec_from_loader(f"peer_{name}", loader=None)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    exec(compile(edit((ROOT / f"{name}.py").read_text()), f"{name}.py", "exec"), module.__dict__)
    return module


def main(domain):
    """Serve until standard input ends."""
    idl = load("idl", lambda text: text.replace("import array, byte,", "import array, uint8 as byte,"))
    api = load("api")
    _domain = Domain(domain, CONFIG)
    participant = DomainParticipant(domain)
    server = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
    low = DataWriter(participant, Topic(participant, "rt/lowstate", idl.LowState))
    sport = DataWriter(participant, Topic(participant, "rt/sportmodestate", idl.SportModeState))
    readers, writers = {}, {}
    for service in api.SERVICES:
        request = Topic(participant, f"rt/api/{service}/request", idl.RequestMessage)
        response = Topic(participant, f"rt/api/{service}/response", idl.ResponseMessage)
        readers[service] = DataReader(participant, request, server)
        writers[service] = DataWriter(participant, response, server)
    print("old peer up", flush=True)
    start = time.monotonic()
    low_body, sport_body = bytearray(1180), bytearray(516)
    low_body[:4] = sport_body[:4] = b"\0\1\0\0"
    struct.pack_into(
        "<10f", low_body, 4 + 24, 1.0, *[0.0] * 8, 9.81
    )  # upright and at rest: attitude, gyro, gravity
    while not select.select([0], [], [], 0.002)[0]:
        elapsed = time.monotonic() - start
        struct.pack_into("<I", low_body, 4 + TICK, int(elapsed * 1000))
        struct.pack_into("<iI", sport_body, 4, int(elapsed), int(elapsed % 1 * 1e9))
        sport_body[4 + MODE] = 1
        struct.pack_into("<f", sport_body, 4 + BODY_HEIGHT, 0.32)
        low.write(idl.LowState.of(bytes(low_body)))
        sport.write(idl.SportModeState.of(bytes(sport_body)))
        for service, reader in readers.items():
            for sample in reader.take(N=32):
                if not hasattr(sample, "cdr"):
                    continue  # a client left
                request = api.Request.unpack(sample.cdr)
                print(service, request.api, request.parameter, flush=True)
                if not request.no_reply:
                    data = '{"form":"0","name":"ai-w"}' if service == "motion_switcher" else ""
                    answer = api.Response(request.id, request.api, 0, data)
                    writers[service].write(idl.ResponseMessage.of(answer.pack()))


TICK, MODE, BODY_HEIGHT = (int(v) for v in sys.argv[2:5])
"""Byte offsets in the message bodies, handed over by the test that knows the layout."""

if __name__ == "__main__":
    main(int(sys.argv[1]))

"""How requests and answers lie on the socket between a service and its worker: length, then msgpack."""

import struct

HEAD = struct.Struct("<I")

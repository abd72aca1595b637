"""Times velodyne-decoder (PyPI, C++) on the packets of a log, on one thread.

usage: packets.py LOG.mcap N_PACKETS RUNS

Prints the seconds of each run, a line each. The packets are made ready first, so that only the
decoder's own call is timed: the packets of a VelodyneScan (about a turn) at a time, as drivers give
them, N_PACKETS of them by going round.
"""

import sys
import time

import velodyne_decoder as vd

from street import packets


def main():
    log, n_packets, runs = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    capture = [vd.VelodynePacket(stamp / 1e9, list(data)) for stamp, data in packets(log)]
    per_message = 181
    turns = []
    for start in range(0, len(capture), per_message):
        turn = vd.PacketVector()
        for packet in capture[start : start + per_message]:
            turn.append(packet)
        turns.append(turn)
    for _ in range(runs):
        # All ranges, as the peer's ring alone cannot be asked for.
        decoder = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=1e9))
        done, start = 0, time.perf_counter()
        while done < n_packets:
            for turn in turns:
                decoder.decode(turn)
                done += len(turn)
        print((time.perf_counter() - start) * n_packets / done)


main()

"""Measures the time that velodyne-decoder (PyPI, C++) needs for the packets of a log, on one thread.

usage: packets.py LOG.mcap N_PACKETS RUNS

Prints the seconds of each run, one per line. The packets are converted first, so only the decoder is
timed. It gets the packets of one VelodyneScan (about one revolution) at a time, as from a driver. The
capture is repeated until N_PACKETS are decoded.
"""

import sys
import time

import velodyne_decoder as vd

from street import packets


def main():
    log, n_packets, runs = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    capture = [vd.VelodynePacket(stamp / 1e9, list(data)) for stamp, data in packets(log)]
    per_message = 181
    revolutions = []
    for start in range(0, len(capture), per_message):
        revolution = vd.PacketVector()
        for packet in capture[start : start + per_message]:
            revolution.append(packet)
        revolutions.append(revolution)
    for _ in range(runs):
        # All rings and ranges: velodyne-decoder cannot decode one ring alone.
        decoder = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=1e9))
        done, start = 0, time.perf_counter()
        while done < n_packets:
            for revolution in revolutions:
                decoder.decode(revolution)
                done += len(revolution)
        print((time.perf_counter() - start) * n_packets / done)


main()

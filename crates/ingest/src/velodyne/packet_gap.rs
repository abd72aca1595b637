//! How two packets lie to each other: by azimuth, by the device clock and by the stamps.

use messages::hdl32e::{AZIMUTH_COUNTS, BLOCK_PERIOD_NS};

use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;

/// A step over more than this many ordinary ones means that packets are missing.
const MAX_STEPS: f64 = MAX_STEPS_HALVES as f64 / 2.0;
const MAX_STEPS_HALVES: u32 = 5;
/// A step back of up to this is jitter of the encoder \[0.01 deg\]: an HDL-32E's is a few counts, a
/// worn one's some more.
const MAX_JITTER: f64 = 100.0;
/// Stamps of two packets that follow each other are no farther apart than this, whatever the
/// network and the host did \[us\].
const STAMPS_ON_TIME_US: f64 = STAMPS_ON_TIME_NS as f64 / 1000.0;
const STAMPS_ON_TIME_NS: i64 = 20_000_000;
/// A device clock that stands still leaves it to the stamps to tell that turns are missing: by this
/// share of a turn's time. Less may be a host that was busy.
const MISSING_REVOLUTION: f64 = 0.9;
/// Time between two packets beyond which the recording is taken to have been interrupted \[us\].
const INTERRUPTED_US: f64 = 2e6;

/// How two successive packets lie to each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Link {
    /// The second follows the first; the step between them \[0.01 deg\].
    Next(u32),
    /// Packets are missing.
    Hole {
        /// The sensor turned on by so much meanwhile \[0.01 deg\].
        turned: u64,
        /// So many packets.
        n_packets: u64,
    },
    /// The second belongs to another recording, or the clock jumped.
    Interrupted,
}

/// Azimuth from one block to the next \[0.01 deg\], clockwise: of the two ways around the shorter,
/// negative for a step back.
fn signed_step(from: u16, to: u16) -> i32 {
    let revolution = i32::from(AZIMUTH_COUNTS);
    let step = (i32::from(to) - i32::from(from)).rem_euclid(revolution);
    if revolution / 2 < step { step - revolution } else { step }
}

/// The step within a packet; a sensor turns one way, so that a step back is encoder jitter.
pub(crate) fn step_within(from: u16, to: u16) -> u32 {
    signed_step(from, to).max(0).unsigned_abs()
}

/// The last step of a packet as its step before tells it.
pub(crate) fn own_step(packet: &RingPacket) -> u32 {
    let n = usize::from(packet.n_firings);
    step_within(packet.azimuth[n - 2], packet.azimuth[n - 1])
}

/// The step from one packet to the next \[0.01 deg\], where azimuth and device clock say that none is
/// between them: what [`PacketGap`] finds for nearly all packets, found faster.
pub(crate) fn ordinary_step(earlier: &RingPacket, later: &RingPacket) -> Option<u32> {
    let n = usize::from(earlier.n_firings);
    let step = u32::from(later.azimuth[0].checked_sub(earlier.azimuth[n - 1])?);
    let turned = u32::from(earlier.azimuth[n - 1].checked_sub(earlier.azimuth[0])?);
    let gap_us = later.device_us.checked_sub(earlier.device_us)?;
    let stamps_ns = later.end_ns.checked_sub(earlier.end_ns)?;
    let is_ordinary = step * (n as u32 - 1) <= MAX_STEPS_HALVES * turned / 2
        && (1..earlier.period_ns() * 3 / 2000).contains(&i64::from(gap_us))
        && (0..STAMPS_ON_TIME_NS).contains(&stamps_ns);
    is_ordinary.then_some(step)
}

/// How one packet lies to the one fired before it, by azimuth and by both clocks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PacketGap {
    /// Azimuth from the last firing of the one to the first of the other \[0.01 deg\].
    step: i32,
    /// An ordinary step within the first of them \[0.01 deg\].
    mean_step: f64,
    /// Time that a packet takes \[us\].
    period_us: f64,
    /// By the device clock \[us\].
    pub(crate) device_us: f64,
    /// By the stamps \[us\].
    pub(crate) stamps_us: f64,
}

impl PacketGap {
    pub(crate) fn new(earlier: &RingPacket, later: &RingPacket) -> Self {
        let n = usize::from(earlier.n_firings);
        let turned = step_within(earlier.azimuth[0], earlier.azimuth[n - 1]);
        Self {
            step: signed_step(earlier.azimuth[n - 1], later.azimuth[0]),
            mean_step: f64::from(turned) / (n - 1) as f64,
            period_us: earlier.period_ns() as f64 / 1000.0,
            device_us: device_gap_us(earlier, later),
            stamps_us: later.end_ns.saturating_sub(earlier.end_ns) as f64 / 1000.0,
        }
    }

    /// Whether the azimuth goes on as it does from one packet to the next.
    fn goes_on(&self) -> bool {
        let most = MAX_STEPS * self.mean_step.max(1.0);
        (-MAX_JITTER..=most).contains(&f64::from(self.step))
    }

    /// Whether azimuth and stamps go on and the device clock does not: it has jumped. One that stands
    /// still has not.
    pub(crate) fn clock_jumped(&self) -> bool {
        let on_time = (0.0..1.5 * self.period_us).contains(&self.device_us);
        !on_time && self.goes_on() && (0.0..STAMPS_ON_TIME_US).contains(&self.stamps_us)
    }

    /// The time of a whole turn \[us\].
    fn revolution_us(&self) -> f64 {
        let n_blocks = f64::from(AZIMUTH_COUNTS) / self.mean_step.max(1.0);
        n_blocks * BLOCK_PERIOD_NS as f64 / 1000.0
    }

    /// How the later packet lies to the earlier one. `late_us` is how much later than due the stamp
    /// is, for a device clock that stands still.
    pub(crate) fn link(&self, late_us: f64) -> Link {
        if self.clock_jumped() {
            return Link::Next(self.step_ahead());
        }
        if self.device_us < 0.0 {
            return Link::Interrupted;
        }
        // The device clock is the finer one. Where it stands still the stamps have to do, of which a
        // whole message can have the same: only a turn's time is told from them.
        let stands_still = self.device_us == 0.0;
        let gap_us = match stands_still {
            true if late_us < MISSING_REVOLUTION * self.revolution_us() => self.period_us,
            true => self.period_us + late_us,
            false => self.device_us,
        };
        let disagree = !stands_still && INTERRUPTED_US < (self.stamps_us - self.device_us).abs();
        if INTERRUPTED_US < gap_us || disagree {
            return Link::Interrupted;
        }
        if gap_us < 1.5 * self.period_us && self.goes_on() {
            return Link::Next(self.step_ahead());
        }
        // The time that passed tells how many whole turns the azimuths hide.
        let revolution = f64::from(AZIMUTH_COUNTS);
        let step = match self.goes_on() {
            true => self.step_ahead(),
            false => self.step.rem_euclid(i32::from(AZIMUTH_COUNTS)).unsigned_abs(),
        };
        let block_us = BLOCK_PERIOD_NS as f64 / 1000.0;
        let n_steps = (gap_us - self.period_us) / block_us + 1.0;
        let expected = n_steps.max(0.0) * self.mean_step;
        let hidden_turns = ((expected - f64::from(step)) / revolution).round().max(0.0) as u64;
        Link::Hole {
            turned: u64::from(step) + hidden_turns * u64::from(AZIMUTH_COUNTS),
            n_packets: ((gap_us / self.period_us).round() as u64).saturating_sub(1),
        }
    }

    fn step_ahead(&self) -> u32 {
        self.step.max(0).unsigned_abs()
    }
}

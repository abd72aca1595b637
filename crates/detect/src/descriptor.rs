//! A descriptor of a submap that hardly changes when the submap is turned or shifted.

use std::f64::consts::{PI, TAU};

use register::{Square, Submap};

/// Cycles per submap of the sampled circles of the spectrum: 2 to 33.
const RADII: std::ops::Range<u32> = 2..34;
/// Directions of the spectrum that are sampled, over half a turn. The other half is the same.
const N_DIRECTIONS: usize = 64;
/// Coefficients that are kept per radius.
const N_COEFFICIENTS: usize = 9;
/// Length of a descriptor.
pub const DESCRIPTOR_LEN: usize = 32 * N_COEFFICIENTS;
/// The highest frequency that the interpolation uses.
const MAX_FREQUENCY: usize = 34;
/// Frequencies from 0 to the highest.
const N_FREQUENCIES: usize = MAX_FREQUENCY + 1;
/// Standard deviation of the blur of the walls \[squares\].
const BLUR_SQUARES: f64 = 0.8;
/// Reach of the blur \[squares\]: four standard deviations.
const BLUR_REACH: u32 = 3;

/// Computes descriptors.
///
/// The amplitude of the Fourier transform of the walls does not change with a shift. A turn of the
/// submap turns it, which is a cyclic shift in polar coordinates, so the amplitude of the Fourier
/// transform over the direction does not change with a turn (Fourier-Mellin; Reddy and Chatterji
/// 1996, "An FFT-based technique for translation, rotation, and scale-invariant image registration").
/// The logarithm of the amplitude keeps the strongest frequencies from hiding the others.
///
/// Few squares are occupied, and only low frequencies are needed. So the sums of the definition are
/// computed directly, in f64 and in a fixed order.
#[derive(Debug, Clone)]
pub struct Describer {
    /// Squares per side of the submap.
    n: usize,
    /// Cosine and sine of `k / n` of a full circle, `(n,)`.
    circle: Vec<[f64; 2]>,
    /// Amplitude of the blur per frequency, `(N_FREQUENCIES,)`.
    blur: Vec<f64>,
    /// Where the circles are sampled, `(32, N_DIRECTIONS)`.
    samples: Vec<Sample>,
    /// Cosine and sine of `k / N_DIRECTIONS` of a full circle.
    directions: Vec<[f64; 2]>,
}

/// A point between four frequencies.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// Index of the lower frequencies in the amplitudes.
    at: usize,
    /// Shares of the four amplitudes: at `at`, next along y, next along x, next along both.
    weights: [f64; 4],
}

impl Describer {
    /// For submaps of `n` by `n` squares.
    ///
    /// # Panics
    /// If `n` is less than 69: such a submap does not have the frequencies.
    pub fn new(n: usize) -> Self {
        assert!(2 * MAX_FREQUENCY < n, "a submap of {n} squares does not have 34 frequencies");
        let circle = circle(n);
        let weight = |k: u32| libm::exp(-0.5 * (f64::from(k) / BLUR_SQUARES).powi(2));
        let sum = 1.0 + 2.0 * (1..=BLUR_REACH).map(weight).sum::<f64>();
        let amplitude = |frequency: usize| {
            let side: f64 =
                (1..=BLUR_REACH).map(|k| weight(k) * circle[frequency * k as usize % n][0]).sum();
            (1.0 + 2.0 * side) / sum
        };
        let blur = (0..N_FREQUENCIES).map(amplitude).collect();
        let samples = RADII
            .flat_map(|radius| (0..N_DIRECTIONS).map(move |k| sample(f64::from(radius), k)))
            .collect();
        Self { n, circle, blur, samples, directions: self::circle(N_DIRECTIONS) }
    }

    /// The descriptor of a submap, `(DESCRIPTOR_LEN,)`: for each of 32 frequencies 2 to 33, the first 9
    /// amplitudes over the direction.
    ///
    /// # Panics
    /// If the submap has another size.
    pub fn describe(&self, submap: &Submap) -> Vec<f32> {
        assert_eq!(submap.n_squares(), self.n, "the describer has the size of the submap");
        let amplitudes = self.log_amplitudes(submap);
        let mut descriptor = Vec::with_capacity(DESCRIPTOR_LEN);
        for samples in self.samples.chunks_exact(N_DIRECTIONS) {
            let polar: Vec<f64> = samples
                .iter()
                .map(|s| {
                    let next = s.at + N_FREQUENCIES;
                    let corners = [s.at, s.at + 1, next, next + 1];
                    corners.iter().zip(s.weights).map(|(&k, w)| w * amplitudes[k]).sum()
                })
                .collect();
            for coefficient in 0..N_COEFFICIENTS {
                let [mut re, mut im] = [0.0; 2];
                for (k, value) in polar.iter().enumerate() {
                    let [cos, sin] = self.directions[k * coefficient % N_DIRECTIONS];
                    re += value * cos;
                    im += value * sin;
                }
                descriptor.push(libm::hypot(re, im) as f32);
            }
        }
        descriptor
    }

    /// ln(1 + amplitude) of the spectrum of the blurred walls at the frequencies -34 to 34 along x and
    /// 0 to 34 along y, `(69, 35)`.
    fn log_amplitudes(&self, submap: &Submap) -> Vec<f64> {
        let mut sums = vec![[[0.0; N_FREQUENCIES]; 4]; N_FREQUENCIES];
        let walls: Vec<[usize; 2]> = submap.of_kind(Square::Occupied).collect();
        for of_row in walls.chunk_by(|a, b| a[0] == b[0]) {
            let row = of_row[0][0];
            let [mut re, mut im] = [[0.0; N_FREQUENCIES]; 2];
            for &[_, column] in of_row {
                for (frequency, (re, im)) in re.iter_mut().zip(&mut im).enumerate() {
                    let [cos, sin] = self.circle[column * frequency % self.n];
                    *re += cos;
                    *im -= sin;
                }
            }
            for (frequency, sums) in sums.iter_mut().enumerate() {
                let [cos, sin] = self.circle[row * frequency % self.n];
                let [re_cos, re_sin, im_cos, im_sin] = sums;
                for k in 0..N_FREQUENCIES {
                    re_cos[k] += re[k] * cos;
                    re_sin[k] += re[k] * sin;
                    im_cos[k] += im[k] * cos;
                    im_sin[k] += im[k] * sin;
                }
            }
        }
        let mut amplitudes = vec![0.0; (2 * MAX_FREQUENCY + 1) * N_FREQUENCIES];
        for (x, [re_cos, re_sin, im_cos, im_sin]) in sums.iter().enumerate() {
            for y in 0..N_FREQUENCIES {
                let blur = self.blur[x] * self.blur[y];
                let log = |re: f64, im: f64| libm::log1p(blur * libm::sqrt(re * re + im * im));
                // (re + i im) (cos - i sin) at the frequency x, and (re + i im) (cos + i sin) at -x.
                amplitudes[(MAX_FREQUENCY + x) * N_FREQUENCIES + y] =
                    log(re_cos[y] + im_sin[y], im_cos[y] - re_sin[y]);
                amplitudes[(MAX_FREQUENCY - x) * N_FREQUENCIES + y] =
                    log(re_cos[y] - im_sin[y], im_cos[y] + re_sin[y]);
            }
        }
        amplitudes
    }
}

/// Cosine and sine of n equal parts of a full circle.
fn circle(n: usize) -> Vec<[f64; 2]> {
    (0..n)
        .map(|k| {
            let (sin, cos) = libm::sincos(TAU * k as f64 / n as f64);
            [cos, sin]
        })
        .collect()
}

/// Linear interpolation at a direction of half a turn.
fn sample(radius: f64, direction: usize) -> Sample {
    let (sin, cos) = libm::sincos(PI * direction as f64 / N_DIRECTIONS as f64);
    let (x, y) = (radius * cos, radius * sin);
    let (x0, y0) = (libm::floor(x), libm::floor(y));
    let (a, b) = (x - x0, y - y0);
    let row = (x0 as i64 + MAX_FREQUENCY as i64) as usize;
    Sample {
        at: row * N_FREQUENCIES + y0 as usize,
        weights: [(1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b],
    }
}

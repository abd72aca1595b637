//! A descriptor of a submap that hardly changes when the submap is turned or shifted.

use register::{Square, Submap};

use crate::fft::{Fft2, Scratch};

/// Radii of the spectrum that are sampled: 2 to 33 cycles per submap.
const RADII: std::ops::Range<usize> = 2..34;
/// Directions of the spectrum that are sampled, over half a turn. The other half is the same.
const N_DIRECTIONS: usize = 64;
/// Coefficients that are kept per radius.
const N_COEFFICIENTS: usize = 9;
/// Length of a descriptor.
pub const DESCRIPTOR_LEN: usize = 32 * N_COEFFICIENTS;
/// Standard deviation of the blur of the walls \[squares\].
const BLUR_SQUARES: f32 = 0.8;

/// Computes descriptors.
///
/// The amplitude of the Fourier transform of the walls does not change with a shift. A turn of the
/// submap turns it, which is a cyclic shift in polar coordinates, so the amplitude of the Fourier
/// transform over the direction does not change with a turn (Fourier-Mellin; Reddy and Chatterji
/// 1996, "An FFT-based technique for translation, rotation, and scale-invariant image registration").
pub struct Describer {
    n: usize,
    image_fft: Fft2,
}

impl Describer {
    /// For submaps of `n` by `n` squares.
    pub fn new(n: usize) -> Self {
        Self { n, image_fft: Fft2::new(n) }
    }

    /// The descriptor of a submap, `(DESCRIPTOR_LEN,)`.
    ///
    /// # Panics
    /// If the submap has another size.
    pub fn describe(&self, submap: &Submap) -> Vec<f32> {
        assert_eq!(submap.n_squares(), self.n, "the describer has the size of the submap");
        let walls: Vec<f32> =
            submap.squares().iter().map(|s| f32::from(*s == Square::Occupied)).collect();
        let blurred = blur(&walls, self.n, BLUR_SQUARES);
        let spectrum = self.image_fft.forward(&blurred, &mut Scratch::default());
        let amplitude = |row: i64, column: i64| -> f32 {
            // The transform of a real image is symmetric about the origin.
            let (row, column) = if column < 0 { (-row, -column) } else { (row, column) };
            let row = row.rem_euclid(self.n as i64) as usize;
            spectrum[column as usize * self.n + row].norm().ln_1p()
        };
        let mut descriptor = Vec::with_capacity(DESCRIPTOR_LEN);
        for radius in RADII {
            let polar: Vec<f32> = (0..N_DIRECTIONS)
                .map(|k| {
                    let angle = std::f64::consts::PI * k as f64 / N_DIRECTIONS as f64;
                    let (sin, cos) = libm::sincos(angle);
                    interpolate(&amplitude, radius as f64 * cos, radius as f64 * sin)
                })
                .collect();
            descriptor.extend(amplitudes(&polar));
        }
        descriptor
    }
}

/// Linear interpolation between the four values around a position.
fn interpolate(at: &impl Fn(i64, i64) -> f32, x: f64, y: f64) -> f32 {
    let (x0, y0) = (libm::floor(x), libm::floor(y));
    let (a, b) = ((x - x0) as f32, (y - y0) as f32);
    let (i, j) = (x0 as i64, y0 as i64);
    (1.0 - a) * ((1.0 - b) * at(i, j) + b * at(i, j + 1))
        + a * ((1.0 - b) * at(i + 1, j) + b * at(i + 1, j + 1))
}

/// The first amplitudes of the Fourier transform of a short series.
fn amplitudes(series: &[f32]) -> impl Iterator<Item = f32> + '_ {
    let n = series.len();
    (0..N_COEFFICIENTS).map(move |k| {
        let [mut re, mut im] = [0.0f64; 2];
        for (j, &value) in series.iter().enumerate() {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * ((j * k) % n) as f64 / n as f64);
            re += f64::from(value) * cos;
            im -= f64::from(value) * sin;
        }
        libm::hypot(re, im) as f32
    })
}

/// Blurs an image with a Gaussian. Outside the image, the values are those of the edge.
pub(crate) fn blur(image: &[f32], n: usize, std: f32) -> Vec<f32> {
    let reach = (4.0 * std + 0.5) as i64;
    let kernel: Vec<f32> =
        (-reach..=reach).map(|k| (-0.5 * (k as f32 / std).powi(2)).exp()).collect();
    let sum: f32 = kernel.iter().sum();
    let pass = |image: &[f32], step: usize, next: usize| -> Vec<f32> {
        let mut blurred = vec![0.0; n * n];
        for line in 0..n {
            for at in 0..n {
                let value: f32 = (-reach..=reach)
                    .zip(&kernel)
                    .map(|(k, weight)| {
                        let from = (at as i64 + k).clamp(0, n as i64 - 1) as usize;
                        weight * image[line * next + from * step]
                    })
                    .sum();
                blurred[line * next + at * step] = value / sum;
            }
        }
        blurred
    };
    pass(&pass(image, 1, n), n, 1)
}

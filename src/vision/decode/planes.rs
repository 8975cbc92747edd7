//! Planes of Y, Cb, Cr to rows of R, G, B; chroma of fewer samples is interpolated as libjpeg does it ("fancy
//! upsampling": three quarters of the nearer sample, one of the farther).

/// Gains of JFIF's conversion with 16 fractional bits: Cr in R, Cb and Cr in G, Cb in B (BT.601, full range).
const GAINS: [i32; 4] = [91_881, -22_554, -46_802, 116_130];

/// Pixels converted together.
const BLOCK: usize = 64;

/// One row of Y, Cb and Cr samples to R, G, B.
#[inline(always)]
pub(super) fn rgb_row(y: &[u8], u: &[u8], v: &[u8], out: &mut [u8]) {
    let n = y.len();
    let (u, v) = (&u[..n], &v[..n]);
    let whole = n / BLOCK * BLOCK;
    for at in (0..whole).step_by(BLOCK) {
        let (y, u, v) = (&y[at..at + BLOCK], &u[at..at + BLOCK], &v[at..at + BLOCK]);
        let (mut r, mut g, mut b) = ([0; BLOCK], [0; BLOCK], [0; BLOCK]);
        for i in 0..BLOCK {
            [r[i], g[i], b[i]] = rgb(y[i], u[i], v[i]);
        }
        let out = &mut out[3 * at..3 * (at + BLOCK)];
        for i in 0..BLOCK {
            out[3 * i] = r[i];
            out[3 * i + 1] = g[i];
            out[3 * i + 2] = b[i];
        }
    }
    for (i, out) in (whole..n).zip(out[3 * whole..].as_chunks_mut::<3>().0) {
        *out = rgb(y[i], u[i], v[i]);
    }
}

#[inline(always)]
fn rgb(y: u8, u: u8, v: u8) -> [u8; 3] {
    let y = (i32::from(y) << 16) + (1 << 15);
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    let [r_v, g_u, g_v, b_u] = GAINS;
    let level = |x: i32| (x >> 16).clamp(0, 255) as u8;
    [level(y + r_v * v), level(y + g_u * u + g_v * v), level(y + b_u * u)]
}

/// A row of half as many samples, mixed from the nearer and the farther row, to whole width. `mixed` has one more
/// place before and behind.
#[inline(always)]
pub(super) fn widened_row(near: &[u8], far: &[u8], mixed: &mut [u16], out: &mut [u8]) {
    let n = near.len();
    for (mixed, (&near, &far)) in mixed[1..].iter_mut().zip(near.iter().zip(far)) {
        *mixed = 3 * u16::from(near) + u16::from(far);
    }
    mixed[0] = mixed[1];
    mixed[n + 1] = mixed[n];
    let around = mixed[..n].iter().zip(&mixed[1..=n]).zip(&mixed[2..n + 2]);
    for (two, ((&left, &here), &right)) in out.as_chunks_mut::<2>().0.iter_mut().zip(around) {
        *two = [((3 * here + left + 8) >> 4) as u8, ((3 * here + right + 7) >> 4) as u8];
    }
}

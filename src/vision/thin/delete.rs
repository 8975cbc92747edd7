//! Which pixels a sub-iteration deletes, as boolean functions of a pixel's neighbours for 64 pixels a word.
//!
//! Neighbours are named as in the articles: `p2` above, then clockwise to `p9`, above on the left.

use super::Algorithm;
use crate::vision::lanes::{A, B, C, Lanes, not};

/// A pixel's neighbours p2 to p9.
pub(super) type Ring<L> = [L; 8];

/// Pixels that the sub-iteration would delete if they are set.
#[inline(always)]
pub(super) fn deletes<L: Lanes>(algorithm: Algorithm, subiteration: usize, ring: Ring<L>) -> L {
    match (algorithm, subiteration) {
        (Algorithm::ZhangSuen, 0) => zhang_suen::<L, 0>(ring),
        (Algorithm::ZhangSuen, _) => zhang_suen::<L, 1>(ring),
        (Algorithm::GuoHall, 0) => guo_hall::<L, 0>(ring),
        (Algorithm::GuoHall, _) => guo_hall::<L, 1>(ring),
    }
}

#[inline(always)]
fn and_three<L: Lanes>(a: L, b: L, c: L) -> L {
    L::ternary::<{ A & B & C }>(a, b, c)
}

#[inline(always)]
fn or_three<L: Lanes>(a: L, b: L, c: L) -> L {
    L::ternary::<{ A | B | C }>(a, b, c)
}

/// a and (b or c).
#[inline(always)]
fn and_either<L: Lanes>(a: L, b: L, c: L) -> L {
    L::ternary::<{ A & (B | C) }>(a, b, c)
}

/// a and not both b and c.
#[inline(always)]
fn and_not_both<L: Lanes>(a: L, b: L, c: L) -> L {
    L::ternary::<{ A & not(B & C) }>(a, b, c)
}

#[inline(always)]
fn exactly_one<L: Lanes>([a, b, c, d]: [L; 4]) -> L {
    let one = L::ternary::<{ (A & not(B | C)) | (B & not(A | C)) | (C & not(A | B)) }>(a, b, c);
    let any = or_three(a, b, c);
    L::ternary::<{ (A & not(C)) | (not(B) & C) }>(one, any, d)
}

/// A step from 0 to 1 among a, b, c. Two such steps cannot follow each other, so there is at most one.
#[inline(always)]
fn rise<L: Lanes>(a: L, b: L, c: L) -> L {
    L::ternary::<{ (not(A) & B) | (not(B) & C) }>(a, b, c)
}

/// A(P1) = 1, 2 <= B(P1) <= 6, and the two products of the sub-iteration are 0.
#[inline(always)]
fn zhang_suen<L: Lanes, const SUBITERATION: usize>([p2, p3, p4, p5, p6, p7, p8, p9]: Ring<L>) -> L {
    let one_run = exactly_one([rise(p2, p3, p4), rise(p4, p5, p6), rise(p6, p7, p8), rise(p8, p9, p2)]);
    // In one run of neighbours two or more are a side and a corner.
    let has_side = and_either(one_run, or_three(p2, p4, p6), p8);
    let two_or_more = and_either(has_side, or_three(p3, p5, p7), p9);
    // Seven with a side missing have all corners; seven with a corner missing have all sides, which the products
    // refuse.
    let up_to_six = and_not_both(two_or_more, and_three(p3, p5, p7), p9);
    if SUBITERATION == 0 {
        and_not_both(up_to_six, and_either(p4, p2, p8), p6)
    } else {
        and_not_both(up_to_six, and_either(p2, p4, p6), p8)
    }
}

/// A part of the neighbours begins after an empty side.
#[inline(always)]
fn part<L: Lanes>(side: L, corner: L, next: L) -> L {
    L::ternary::<{ not(A) & (B | C) }>(side, corner, next)
}

#[inline(always)]
fn or<L: Lanes>(a: L, b: L) -> L {
    L::ternary::<{ A | B }>(a, b, b)
}

/// Two or more of four.
#[inline(always)]
fn two_of<L: Lanes>(a: L, b: L, c: L, d: L) -> L {
    let two_of_three = L::ternary::<{ (A & B) | (A & C) | (B & C) }>(a, b, c);
    L::ternary::<{ A | (B & C) }>(two_of_three, or_three(a, b, c), d)
}

/// C(P1) = 1, 2 <= N(P1) <= 3, and the term of the sub-iteration is 0.
#[inline(always)]
fn guo_hall<L: Lanes, const SUBITERATION: usize>([p2, p3, p4, p5, p6, p7, p8, p9]: Ring<L>) -> L {
    let one_part = exactly_one([part(p2, p3, p4), part(p4, p5, p6), part(p6, p7, p8), part(p8, p9, p2)]);
    let (a, b, c, d) = (or(p9, p2), or(p3, p4), or(p5, p6), or(p7, p8));
    let (e, f, g, h) = (or(p2, p3), or(p4, p5), or(p6, p7), or(p8, p9));
    let two_or_more = and_three(one_part, two_of(a, b, c, d), two_of(e, f, g, h));
    let four = and_three(and_three(a, b, c), and_three(d, e, f), L::ternary::<{ A & B }>(g, h, h));
    let up_to_three = L::ternary::<{ A & not(B) }>(two_or_more, four, four);
    let (either, or_not, and) = if SUBITERATION == 0 { ((p6, p7), p9, p8) } else { ((p2, p3), p5, p4) };
    and_not_both(up_to_three, L::ternary::<{ A | B | not(C) }>(either.0, either.1, or_not), and)
}

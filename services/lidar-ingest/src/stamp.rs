//! Stamps between text and integer nanoseconds.
//!
//! A double holds a present-day stamp in seconds only to about 0.1 µs, so stamps never pass through one.

use std::fmt;

const NS_PER_S: i64 = 1_000_000_000;

/// Reads seconds written in decimal (`976052905.167303`, `-0.5`, `1.3e+09`) as nanoseconds, exact to the last digit;
/// what is below a nanosecond is cut off. `None` when it is no such number or out of range.
pub fn parse_stamp_ns(text: &str) -> Option<i64> {
    let (negative, unsigned) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let (mantissa, exponent) = match unsigned.find(['e', 'E']) {
        Some(at) => (&unsigned[..at], unsigned[at + 1..].parse::<i32>().ok()?),
        None => (unsigned, 0),
    };
    let (digits, decimals) = read_digits(mantissa)?;
    let shift = 9i32.checked_add(exponent)?.checked_sub(decimals)?;
    let magnitude = shift_decimal(digits, shift)?;
    Some(if negative { -magnitude } else { magnitude })
}

/// The digits of `12.345` as one integer, and how many of them stood behind the point. Digits beyond what an integer of
/// 128 bits holds are cut off.
fn read_digits(mantissa: &str) -> Option<(u128, i32)> {
    const FULL: u128 = u128::MAX / 10 - 1;
    let (mut value, mut decimals, mut seen, mut behind_point) = (0u128, 0i32, false, false);
    for byte in mantissa.bytes() {
        match byte {
            b'0'..=b'9' => {
                seen = true;
                if value < FULL {
                    value = value * 10 + u128::from(byte - b'0');
                    decimals += i32::from(behind_point);
                } else if !behind_point {
                    return None;
                }
            }
            b'.' if !behind_point => behind_point = true,
            _ => return None,
        }
    }
    seen.then_some((value, decimals))
}

/// `value · 10^shift`, cut off to an integer.
fn shift_decimal(value: u128, shift: i32) -> Option<i64> {
    if value == 0 {
        return Some(0);
    }
    let power = 10u128.checked_pow(shift.unsigned_abs());
    let shifted = match power {
        Some(power) if shift >= 0 => value.checked_mul(power)?,
        Some(power) => value / power,
        None if shift >= 0 => return None,
        None => 0,
    };
    i64::try_from(shifted).ok()
}

/// Prints nanoseconds as seconds with six decimals, as logs and TUM trajectories have them; with nine when the stamp is
/// finer than a microsecond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StampText(
    /// The stamp, nanoseconds.
    pub i64,
);

impl fmt::Display for StampText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let magnitude = self.0.unsigned_abs();
        let (seconds, rest) = (magnitude / NS_PER_S as u64, magnitude % NS_PER_S as u64);
        if rest.is_multiple_of(1000) {
            write!(f, "{sign}{seconds}.{:06}", rest / 1000)
        } else {
            write!(f, "{sign}{seconds}.{rest:09}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_what_logs_contain() {
        let cases = [
            ("976052905.167303", 976_052_905_167_303_000),
            ("90.239599", 90_239_599_000),
            ("12", 12_000_000_000),
            ("0.5", 500_000_000),
            (".5", 500_000_000),
            ("-0.5", -500_000_000),
            ("3.", 3_000_000_000),
            ("1.3e+09", 1_300_000_000_000_000_000),
            ("9.760528573378600e8", 976_052_857_337_860_000),
            ("5e-10", 0),
            ("0.0000000000000000000000000000000000000000000000001", 0),
        ];
        for (text, stamp_ns) in cases {
            assert_eq!(parse_stamp_ns(text), Some(stamp_ns), "{text}");
        }
    }

    #[test]
    fn refuses_what_is_no_stamp() {
        for text in
            ["", "-", ".", "nan", "inf", "1.2.3", "1e", "host", "1e400", "99999999999999999999", "--1", "1 2"]
        {
            assert_eq!(parse_stamp_ns(text), None, "{text}");
        }
    }

    proptest! {
        #[test]
        fn text_and_back(stamp_ns in any::<i64>().prop_filter("has no magnitude", |ns| *ns != i64::MIN)) {
            prop_assert_eq!(parse_stamp_ns(&StampText(stamp_ns).to_string()), Some(stamp_ns));
        }

        #[test]
        fn never_panics(text in "\\PC*") {
            let _ = parse_stamp_ns(&text);
        }
    }
}

//! One file a command: parse, build, run, exit code.

pub mod accuracy;
pub mod check;
pub mod devices;
pub mod pictures;
pub mod recognize;
pub mod run;
pub mod session;

/// Reads an option's value: a whole number within these limits, ends included.
pub(crate) fn whole<T: TryFrom<u64>>(from: u64, to: u64) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| (from..=to).contains(number));
        let number = number.and_then(|number: u64| T::try_from(number).ok());
        number.ok_or_else(|| format!("must be a whole number from {from} to {to}"))
    }
}

//! Which instructions a stage uses.

use std::sync::LazyLock;

/// Instruction sets that stages have code for. All give the same bits; results never depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// 64-bit words, on every machine.
    Plain,
    /// 256-bit vectors: AVX2 with BMI1, BMI2 and POPCNT (Haswell, Zen and later).
    Avx2,
    /// 512-bit vectors: AVX-512 with F, BW, DQ, VL, VBMI, VBMI2 and VNNI, and LZCNT (Ice Lake, Zen 4 and later).
    Avx512,
}

impl Level {
    /// The best one this machine has.
    pub fn detect() -> Self {
        *Self::available().last().unwrap_or(&Self::Plain)
    }

    /// This one, or the best one that this machine has where it lacks this.
    pub fn supported(self) -> Self {
        self.min(Self::detect())
    }

    /// All that this machine has, slowest first.
    pub fn available() -> &'static [Level] {
        static AVAILABLE: LazyLock<&[Level]> = LazyLock::new(Level::look);
        *AVAILABLE
    }

    fn look() -> &'static [Level] {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("popcnt");
            let avx512 = avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512vbmi")
                && is_x86_feature_detected!("avx512vbmi2")
                && is_x86_feature_detected!("avx512vnni")
                && is_x86_feature_detected!("lzcnt");
            if avx512 {
                return &[Level::Plain, Level::Avx2, Level::Avx512];
            }
            if avx2 {
                return &[Level::Plain, Level::Avx2];
            }
        }
        &[Level::Plain]
    }

    /// Name for tables: `avx512`, `avx2` or `plain`.
    pub fn name(self) -> &'static str {
        match self {
            Level::Plain => "plain",
            Level::Avx2 => "avx2",
            Level::Avx512 => "avx512",
        }
    }
}

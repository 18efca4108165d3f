//! Which registers the processor takes for used.
#![allow(unsafe_code)]

/// Whether the upper halves of the vector registers (AVX, AVX-512) are in use; `None` where the processor
/// does not tell.
pub fn upper_halves_in_use() -> Option<bool> {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};

        #[target_feature(enable = "xsave")]
        fn in_use() -> u64 {
            // SAFETY: register 1 of XGETBV is there, as asked below.
            unsafe { _xgetbv(1) }
        }

        let tells = __cpuid(0).eax >= 0xd && __cpuid_count(0xd, 1).eax & 4 != 0;
        if tells && is_x86_feature_detected!("xsave") {
            // bit 2: upper halves of the first sixteen 256-bit registers; bit 6: of the 512-bit ones
            // SAFETY: the feature has been detected.
            return Some(unsafe { in_use() } & (1 << 2 | 1 << 6) != 0);
        }
    }
    None
}

//! Loops compiled for the widest vectors that the machine has.

/// Runs a closure, marked `#[inline(always)]`, with the best vector instructions there are. Sums and
/// products are the same on every machine: nothing is fused or reordered.
#[inline(always)]
pub fn dispatch_simd<R>(run: impl FnMut() -> R) -> R {
    pulp::Arch::new().dispatch(SimdClosure(run))
}

/// A closure given to `dispatch` as it is would be called through a shim that is never inlined, and
/// so be compiled for any machine.
struct SimdClosure<F>(F);

impl<R, F: FnMut() -> R> pulp::WithSimd for SimdClosure<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

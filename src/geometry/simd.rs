//! Runs loops with the widest vector registers that the machine has.

/// Runs a closure, which must be marked `#[inline(always)]`, with the best vector instructions of
/// the machine. Sums and products are the same on every machine: nothing is fused or reordered.
#[inline(always)]
pub fn dispatch_simd<R>(run: impl FnMut() -> R) -> R {
    pulp::Arch::new().dispatch(SimdClosure(run))
}

/// Wraps a closure for `dispatch`. A closure passed directly would be called through a function
/// that is never inlined, and so be compiled without the wide instructions.
struct SimdClosure<F>(F);

impl<R, F: FnMut() -> R> pulp::WithSimd for SimdClosure<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

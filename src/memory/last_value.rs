//! A value that stays in memory until another takes its place.

use std::any::Any;
use std::sync::{Arc, Mutex, PoisonError};

use crate::Result;

/// A slot for one value of any type. Work that is done again and again with the same input keeps
/// there what is expensive to make.
#[derive(Debug, Default)]
pub(crate) struct LastValue {
    value: Mutex<Option<Arc<dyn Any + Send + Sync>>>,
}

impl LastValue {
    /// Returns the value, if it is a `T` for which `fits` returns `true`; otherwise replaces it by
    /// the one that `make` returns.
    ///
    /// # Errors
    /// Returns the errors of `make`.
    pub fn get_or_make<T: Send + Sync + 'static>(
        &self,
        fits: impl FnOnce(&T) -> bool,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<Arc<T>> {
        // The value is complete whenever the lock is released.
        let mut slot = self.value.lock().unwrap_or_else(PoisonError::into_inner);
        let last = slot.clone().and_then(|last| last.downcast::<T>().ok());
        if let Some(last) = last.filter(|last| fits(last)) {
            return Ok(last);
        }
        // Both values together may not fit into memory.
        *slot = None;
        let made = Arc::new(make()?);
        *slot = Some(Arc::clone(&made) as Arc<dyn Any + Send + Sync>);
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_stays_until_another_takes_its_place() {
        let slot = LastValue::default();
        let get = |number: i32| slot.get_or_make(|known: &i32| *known == number, || Ok(number));
        let first = get(1).unwrap();
        assert!(Arc::ptr_eq(&first, &get(1).unwrap()));
        assert_eq!(*get(2).unwrap(), 2);
        assert!(!Arc::ptr_eq(&first, &get(1).unwrap()));
        let text = slot.get_or_make(|_: &String| true, || Ok("text".into()));
        assert_eq!(*text.unwrap(), "text");
    }
}

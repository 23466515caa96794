//! Arrays and field values of the library as read-only NumPy arrays without copies.

use atomesh::files::vtk::{DataArray, Values};
use atomesh::store::FieldValue;
use numpy::ndarray::{ArrayViewD, IxDyn};
use numpy::{Element, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::parts::Named;

/// Returns a NumPy array of data that `owner` holds.
pub(super) fn view<'py, T: Element>(
    owner: Bound<'py, PyAny>,
    data: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let view = ArrayViewD::from_shape(IxDyn(shape), data)
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    // SAFETY: `data` belongs to a frozen class, which never changes or moves it while the object
    // lives, and the array keeps the object alive. The array becomes read-only before Python code
    // gets it.
    let array = unsafe { PyArrayDyn::borrow_from_array(&view, owner) };
    let array = array.readwrite().make_nonwriteable();
    Ok((*array).clone().into_any())
}

pub(super) fn values<'py>(
    owner: &Bound<'py, PyAny>,
    array: &DataArray,
) -> PyResult<Bound<'py, PyAny>> {
    let tuples = array.values.len() / array.components.max(1);
    let shape = match array.components {
        1 => vec![tuples],
        components => vec![tuples, components],
    };
    macro_rules! typed_view {
        ($($kind:ident)*) => {
            match &array.values {
                $(Values::$kind(data) => view(owner.clone(), data, &shape),)*
            }
        };
    }
    typed_view!(I8 U8 I16 U16 I32 U32 I64 U64 F32 F64)
}

pub(super) fn all_values<'py>(
    owner: &Bound<'py, PyAny>,
    arrays: &[DataArray],
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(owner.py());
    for array in arrays {
        dict.set_item(&array.name, values(owner, array)?)?;
    }
    Ok(dict)
}

pub(super) fn named_values<'py>(
    owner: &Bound<'py, PyAny>,
    arrays: &[DataArray],
) -> PyResult<Named<'py>> {
    let named = |array: &DataArray| Ok((array.name.clone(), values(owner, array)?));
    arrays.iter().map(named).collect()
}

/// Returns field values as text and arrays, which keep their types even if they are empty.
pub(super) fn named_fields<'py>(
    owner: &Bound<'py, PyAny>,
    fields: &[(String, FieldValue)],
) -> PyResult<Named<'py>> {
    let named = |(name, value): &(String, FieldValue)| {
        let value = match value {
            FieldValue::Text(text) => PyString::new(owner.py(), text).into_any(),
            FieldValue::F64s(numbers) => view(owner.clone(), numbers, &[numbers.len()])?,
            FieldValue::Ints(numbers) => view(owner.clone(), numbers, &[numbers.len()])?,
        };
        Ok((name.clone(), value))
    };
    fields.iter().map(named).collect()
}

pub(super) fn fields<'py>(
    py: Python<'py>,
    fields: &[(String, FieldValue)],
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, value) in fields {
        match value {
            FieldValue::Text(text) => dict.set_item(name, text)?,
            FieldValue::F64s(numbers) => dict.set_item(name, numbers)?,
            FieldValue::Ints(numbers) => dict.set_item(name, numbers)?,
        }
    }
    Ok(dict)
}

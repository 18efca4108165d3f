//! A result as named arrays: the one description that every file format is written from.

/// A result as named arrays.
///
/// An array with the name of its only dimension is the coordinate of that dimension. Numbers that are not
/// known are NaN.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Dataset {
    /// What is said of the whole, by name.
    pub attributes: Vec<(&'static str, String)>,
    /// The arrays; none is empty.
    pub arrays: Vec<Array>,
}

/// An array of a result, the last dimension fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Its name: letters, digits and `_`.
    pub name: String,
    /// Names of its dimensions.
    pub dimensions: Vec<&'static str>,
    /// Length of each dimension.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Values,
    /// SI unit as UDUNITS has it; "1" for numbers without one, nothing for texts.
    pub unit: &'static str,
    /// What it is, in words.
    pub long_name: String,
    /// Names of further arrays that say where its values belong, with spaces between.
    pub coordinates: &'static str,
}

/// The values of an array.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Numbers.
    Floats(Vec<f64>),
    /// Whole numbers.
    Integers(Vec<i32>),
    /// Texts.
    Texts(Vec<String>),
}

impl Values {
    /// How many.
    pub fn len(&self) -> usize {
        match self {
            Values::Floats(values) => values.len(),
            Values::Integers(values) => values.len(),
            Values::Texts(values) => values.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Dataset {
    /// An array of numbers by its name.
    pub fn floats(&self, name: &str) -> Option<&[f64]> {
        match &self.arrays.iter().find(|array| array.name == name)?.values {
            Values::Floats(values) => Some(values),
            _ => None,
        }
    }

    /// Adds an array of numbers.
    ///
    /// # Panics
    /// If there are not as many values as the dimensions hold.
    pub(super) fn put(
        &mut self,
        name: impl Into<String>,
        dimensions: &[(&'static str, usize)],
        values: Vec<f64>,
        unit: &'static str,
        long_name: impl Into<String>,
    ) {
        self.add(name, dimensions, Values::Floats(values), unit, long_name);
    }

    /// Adds an array; one without values is left out.
    ///
    /// # Panics
    /// If there are not as many values as the dimensions hold.
    pub(super) fn add(
        &mut self,
        name: impl Into<String>,
        dimensions: &[(&'static str, usize)],
        values: Values,
        unit: &'static str,
        long_name: impl Into<String>,
    ) {
        let name = name.into();
        let shape: Vec<usize> = dimensions.iter().map(|(_, length)| *length).collect();
        assert_eq!(shape.iter().product::<usize>(), values.len(), "values of {name}");
        if !values.is_empty() {
            let dimensions: Vec<&'static str> = dimensions.iter().map(|(name, _)| *name).collect();
            let long_name = long_name.into();
            self.arrays.push(Array { name, dimensions, shape, values, unit, long_name, coordinates: "" });
        }
    }

    /// Says of all other arrays along a dimension that these tell where their values belong.
    pub(super) fn locate(&mut self, dimension: &str, coordinates: &'static str) {
        let is_other = |array: &&mut Array| {
            array.dimensions.contains(&dimension)
                && array.name != dimension
                && !coordinates.split(' ').any(|name| name == array.name)
        };
        self.arrays.iter_mut().filter(is_other).for_each(|array| array.coordinates = coordinates);
    }
}

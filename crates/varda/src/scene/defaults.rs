//! What is left out of a scene that is written.

/// Whether a value is its type's default, which a scene need not say.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

//! Material and cross-section, and the stiffnesses they give.

use crate::Error;

/// An elastic material.
///
/// ```
/// use varda_rod::Material;
///
/// let silicone = Material::new(1e6, 0.5, 1100.0); // E [Pa], Poisson's ratio, density [kg/m³]
/// assert!((silicone.shear_modulus - 1e6 / 3.0).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Young's modulus E \[Pa\].
    pub youngs_modulus: f64,
    /// Shear modulus G \[Pa\]; E / (2 (1 + ν)) where Poisson's ratio ν is known.
    pub shear_modulus: f64,
    /// Density ρ \[kg/m³\].
    pub density: f64,
}

impl Material {
    /// From Young's modulus E \[Pa\], Poisson's ratio ν and density ρ [kg/m³]: G = E / (2 (1 + ν)).
    pub fn new(youngs_modulus: f64, poisson_ratio: f64, density: f64) -> Self {
        Material { youngs_modulus, shear_modulus: youngs_modulus / (2.0 * (1.0 + poisson_ratio)), density }
    }
}

/// Stiffness and mass of a section, whatever its shape.
///
/// ```
/// use varda_rod::{Material, Section};
///
/// let material = Material::new(1e6, 0.5, 1100.0);
/// let round = Section::circle(&material, 0.01);
/// // a tape: EI₂ is that of bending over its flat side
/// let tape = Section { ei2: 0.01 * round.ei2, ..round };
/// assert!((round.ea - 1e6 * std::f64::consts::PI * 1e-4).abs() < 1e-9 && tape.ei2 < tape.ei1);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// Stretching stiffness E A \[N\].
    pub ea: f64,
    /// Bending stiffness of κ₁ (curvature in the direction m₁) \[N m²\].
    pub ei1: f64,
    /// Bending stiffness of κ₂ (curvature in the direction m₂) \[N m²\].
    pub ei2: f64,
    /// Twisting stiffness G J \[N m²\].
    pub gj: f64,
    /// Mass per length ρ A \[kg/m\].
    pub mass_per_length: f64,
}

impl Section {
    /// A full circle of radius r \[m\]: A = πr², I = πr⁴/4, J = πr⁴/2.
    pub fn circle(material: &Material, radius: f64) -> Self {
        Self::ellipse(material, radius, radius)
    }

    /// A full ellipse with semi-axes a₁ along m₁ and a₂ along m₂ \[m\]: EI₁ = E π a₁³ a₂ / 4,
    /// EI₂ = E π a₁ a₂³ / 4 and Saint-Venant's torsion constant J = π a₁³ a₂³ / (a₁² +
    /// a₂²) (Timoshenko and Goodier, 1970, §107).
    pub fn ellipse(material: &Material, a1: f64, a2: f64) -> Self {
        let pi = std::f64::consts::PI;
        let (e, g, area) = (material.youngs_modulus, material.shear_modulus, pi * a1 * a2);
        Section {
            ea: e * area,
            ei1: e * area * a1 * a1 / 4.0,
            ei2: e * area * a2 * a2 / 4.0,
            gj: g * area * (a1 * a2) * (a1 * a2) / (a1 * a1 + a2 * a2),
            mass_per_length: material.density * area,
        }
    }

    /// A full rectangle, w₁ along m₁ by w₂ along m₂ \[m\]: EI₁ = E w₁³ w₂ / 12, EI₂ = E w₁
    /// w₂³ / 12 and, with a the longer and b the shorter side, J ≈ a b³ (1/3 − 0.21 (b/a) (1 −
    /// b⁴/(12 a⁴))) (Young and Budynas, 2002, table 10.1; 0.4 %).
    pub fn rectangle(material: &Material, w1: f64, w2: f64) -> Self {
        let (a, b) = (w1.max(w2), w1.min(w2));
        let r = b / a;
        let j = a * b.powi(3) * (1.0 / 3.0 - 0.21 * r * (1.0 - r.powi(4) / 12.0));
        Section {
            ea: material.youngs_modulus * w1 * w2,
            ei1: material.youngs_modulus * w1.powi(3) * w2 / 12.0,
            ei2: material.youngs_modulus * w1 * w2.powi(3) / 12.0,
            gj: material.shear_modulus * j,
            mass_per_length: material.density * w1 * w2,
        }
    }

    /// ρ (I₁ + I₂) per length [kg m]: what a section of this material resists a spin about the tangent
    /// with. For [`Rod::with_rotary_inertia`](crate::Rod::with_rotary_inertia).
    pub fn rotary_inertia(&self, material: &Material) -> f64 {
        material.density * (self.ei1 + self.ei2) / material.youngs_modulus
    }

    /// # Errors
    /// [`Error::Value`] where a stiffness is negative or not finite, or a mass or EA not positive.
    pub(crate) fn check(&self) -> Result<(), Error> {
        positive("section EA", self.ea)?;
        positive("section mass per length", self.mass_per_length)?;
        not_negative("section EI1", self.ei1)?;
        not_negative("section EI2", self.ei2)?;
        not_negative("section GJ", self.gj)
    }
}

pub(crate) fn positive(field: &'static str, value: f64) -> Result<(), Error> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(Error::Value { field, value, expected: "a positive number" })
    }
}

pub(crate) fn not_negative(field: &'static str, value: f64) -> Result<(), Error> {
    if value >= 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(Error::Value { field, value, expected: "zero or a positive number" })
    }
}

/// Damping that is there stays positive, and damping that is not stays zero.
pub(crate) fn positive_or_none(field: &'static str, before: f64, value: f64) -> Result<(), Error> {
    if before == 0.0 { not_negative(field, value) } else { positive(field, value) }
}

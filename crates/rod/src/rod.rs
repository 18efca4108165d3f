//! The discrete rod: stiffness, rest shape and mass of every segment and vertex.

use crate::Error;
use crate::material::{Section, not_negative, positive};

/// A discrete elastic rod of n segments (edges 0 … n−1, vertices 0 … n, interior vertices 1 … n−1).
///
/// Strains are integrated over the vertex (no division by a length), energies (paper, section 5.2) are
///
/// ```text
/// E_ε = ½ Σ_e EA_e (l_e − l̄_e)² / l̄_e                         per edge
/// E_κ = ½ Σ_i (κ_i − κ̄_i)ᵀ EI_i (κ_i − κ̄_i) / l̄_i         per interior vertex
/// E_τ = ½ Σ_i GJ_i (τ_i − τ̄_i)² / l̄_i                   per interior vertex
/// l̄_i = (l̄^{i−1} + l̄^i)/2
/// ```
///
/// Plain data: fill it by hand for a rod that varies along its length, or by [`Rod::uniform`].
///
/// ```
/// use varda_rod::{Material, Rod, Section};
///
/// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
/// // 1 m in 20 segments, naturally curved to a radius of 2 m, with 10 g at its end
/// let mut rod = Rod::uniform(1.0, 20, &section)?.naturally([0.5, 0.0], 0.0);
/// rod.add_point_mass(1.0, 0.01)?;
/// assert_eq!((rod.segments(), rod.masses.len()), (20, 21));
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Rod {
    /// Rest length l̄ of every edge \[m\]; n of them. At the face of a clamp, where s = 0, the first is the
    /// half of the held edge that stands out of it (see [`Rod::with_faces`]).
    pub rest_lengths: Vec<f64>,
    /// Length l̄_i belonging to every interior vertex in E_κ and E_τ \[m\]; n − 1.
    pub voronoi_lengths: Vec<f64>,
    /// Stretching stiffness EA of every edge \[N\]; n.
    pub ea: Vec<f64>,
    /// Bending stiffness of every interior vertex \[N m²\], symmetric 2 × 2 as (11, 12, 22); n − 1.
    pub ei: Vec<[f64; 3]>,
    /// Twisting stiffness GJ of every interior vertex \[N m²\]; n − 1.
    pub gj: Vec<f64>,
    /// Natural integrated curvature κ̄ = (κ̄₁, κ̄₂) of every interior vertex \[–\]; n − 1.
    pub natural_curvature: Vec<[f64; 2]>,
    /// Natural integrated twist τ̄ of every interior vertex \[rad\]; n − 1.
    pub natural_twist: Vec<f64>,
    /// Mass of every vertex \[kg\], half of that of the edges beside it; n + 1.
    pub masses: Vec<f64>,
    /// Inertia of every edge against a spin about its tangent, I^e = ρ l̄^e (I₁ + I₂) \[kg m²\]; n.
    /// Empty where twist is massless (see [`Rod::with_rotary_inertia`]).
    pub spin_inertia: Vec<f64>,
}

impl Rod {
    /// A naturally straight rod of one section, cut into equal segments.
    ///
    /// # Errors
    /// [`Error::Value`] for a length that is not positive, fewer than one segment, or an impossible section.
    pub fn uniform(length: f64, segments: usize, section: &Section) -> Result<Rod, Error> {
        Rod::uniform_between(length, segments, section, [false, false])
    }

    /// The same for a rod that clamps hold at their faces (`faces`: at its start, at its end), `length` from
    /// face to face or to the free end: [`Rod::equal_segments`], [`Rod::with_faces`].
    ///
    /// ```
    /// use varda_rod::{Material, Rod, Section};
    ///
    /// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
    /// let rod = Rod::uniform_between(1.0, 3, &section, [true, false])?;
    /// assert_eq!(rod.arc_lengths(), [0.0, 0.2, 0.6000000000000001, 1.0]); // 0.2 m more behind the face
    /// # Ok::<(), varda_rod::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Rod::uniform`].
    pub fn uniform_between(
        length: f64,
        segments: usize,
        section: &Section,
        faces: [bool; 2],
    ) -> Result<Rod, Error> {
        positive("rod length", length)?;
        if segments == 0 {
            return Err(Error::Value { field: "segments", value: 0.0, expected: "at least 1" });
        }
        let lengths = Rod::equal_segments(length, segments, faces);
        Ok(Rod::with_segments(&lengths, section)?.with_faces(faces))
    }

    /// Rest lengths \[m\] of n equal edges of a rod of this length from face to face, or to a free end. Half
    /// of an edge that a clamp holds at its face is behind that face: l = L/(n − ½ per face), and l/2 for
    /// the first or last.
    pub fn equal_segments(length: f64, segments: usize, faces: [bool; 2]) -> Vec<f64> {
        let behind = faces.map(|face| if face { 0.5 } else { 0.0 });
        let edge = length / (segments as f64 - (behind[0] + behind[1]));
        let mut lengths = vec![edge; segments];
        for (face, e) in [(faces[0], 0), (faces[1], segments.saturating_sub(1))] {
            if face && segments > 0 {
                lengths[e] *= 0.5;
            }
        }
        lengths
    }

    /// A naturally straight rod of one section with the given segment lengths \[m\].
    ///
    /// # Errors
    /// As [`Rod::uniform`].
    pub fn with_segments(rest_lengths: &[f64], section: &Section) -> Result<Rod, Error> {
        section.check()?;
        let n = rest_lengths.len();
        let inner = n.saturating_sub(1);
        let rho = section.mass_per_length;
        let half = |i: usize| rest_lengths.get(i).map_or(0.0, |l| 0.5 * l);
        let rod = Rod {
            rest_lengths: rest_lengths.to_vec(),
            voronoi_lengths: (1..n).map(|i| half(i - 1) + half(i)).collect(),
            ea: vec![section.ea; n],
            ei: vec![[section.ei1, 0.0, section.ei2]; inner],
            gj: vec![section.gj; inner],
            natural_curvature: vec![[0.0; 2]; inner],
            natural_twist: vec![0.0; inner],
            masses: (0..=n).map(|i| rho * (if i > 0 { half(i - 1) } else { 0.0 } + half(i))).collect(),
            spin_inertia: Vec::new(),
        };
        rod.check()?;
        Ok(rod)
    }

    /// The same rod, naturally curved and twisted: κ̄_i = `curvature` l̄_i, τ̄_i = `twist` l̄_i, both
    /// per length \[1/m\].
    pub fn naturally(mut self, curvature: [f64; 2], twist: f64) -> Rod {
        for (i, l) in self.voronoi_lengths.iter().enumerate() {
            self.natural_curvature[i] = [curvature[0] * l, curvature[1] * l];
            self.natural_twist[i] = twist * l;
        }
        self
    }

    /// The same rod, its sections having inertia against a spin about the tangent: ρ (I₁ + I₂) per
    /// length \[kg m\], [`Section::rotary_inertia`] of a uniform one. Twist then travels in waves of speed
    /// √(GJ/ρ(I₁ + I₂)), in place of being in equilibrium at every moment.
    ///
    /// ```
    /// use varda_rod::{Material, Rod, Section};
    ///
    /// let material = Material::new(1e6, 0.5, 1100.0);
    /// let section = Section::circle(&material, 0.01);
    /// let rod = Rod::uniform(1.0, 20, &section)?.with_rotary_inertia(section.rotary_inertia(&material));
    /// let of_disc = 0.05 * 1100.0 * std::f64::consts::PI * 0.01_f64.powi(4) / 2.0;
    /// assert!((rod.spin_inertia[7] / of_disc - 1.0).abs() < 1e-12);
    /// # Ok::<(), varda_rod::Error>(())
    /// ```
    #[must_use]
    pub fn with_rotary_inertia(mut self, per_length: f64) -> Rod {
        self.spin_inertia = self.rest_lengths.iter().map(|l| per_length * l).collect();
        self
    }

    /// The same rod held by clamps at their faces, at its start and at its end: the held edge has its middle
    /// at the face, so that as much of it is behind the face as the first (last) rest length is outside. Of
    /// what is behind, one length is felt, that of the vertex outside:
    ///
    /// ```text
    /// l̄_1 = l̄^0 + l̄^1/2        in place of (l̄^0 + l̄^1)/2
    /// ```
    ///
    /// Natural strains of that vertex keep their values per length. Mass and weight stay what is outside:
    /// ρAL in all. What takes a rod together with its supports does this itself, and doing it again changes
    /// nothing.
    #[must_use]
    pub fn with_faces(mut self, faces: [bool; 2]) -> Rod {
        let n = self.segments();
        if n < 2 {
            return self;
        }
        let whole = |e: usize| {
            let held = e == 0 && faces[0] || e + 1 == n && faces[1];
            self.rest_lengths[e] * if held { 1.0 } else { 0.5 }
        };
        let lengths =
            [(faces[0], 1), (faces[1], n - 1)].map(|(face, i)| (face, i - 1, whole(i - 1) + whole(i)));
        for (_, i, length) in lengths.into_iter().filter(|(face, ..)| *face) {
            let more = length / self.voronoi_lengths[i];
            if more != 1.0 {
                self.voronoi_lengths[i] = length;
                self.natural_curvature[i] = self.natural_curvature[i].map(|k| k * more);
                self.natural_twist[i] *= more;
            }
        }
        self
    }

    /// Adds a point mass \[kg\] at arc length s \[m\], shared linearly by the two vertices beside it.
    ///
    /// # Errors
    /// [`Error::OffRod`], or [`Error::Value`] for a negative mass.
    pub fn add_point_mass(&mut self, s: f64, mass: f64) -> Result<(), Error> {
        not_negative("point mass", mass)?;
        let place = self.place("point mass", s)?;
        self.masses[place.edge] += mass * (1.0 - place.fraction);
        self.masses[place.edge + 1] += mass * place.fraction;
        Ok(())
    }

    /// n, the number of segments.
    pub fn segments(&self) -> usize {
        self.rest_lengths.len()
    }

    /// Rest length of the whole rod L \[m\].
    pub fn length(&self) -> f64 {
        self.rest_lengths.iter().sum()
    }

    /// Rest arc length s_i of every vertex \[m\].
    pub fn arc_lengths(&self) -> Vec<f64> {
        let mut s = vec![0.0];
        s.extend(self.rest_lengths.iter().scan(0.0, |sum, l| {
            *sum += l;
            Some(*sum)
        }));
        s
    }

    /// The edge at rest arc length s, and where on it. A place within 1e-9 L of an end counts as that end.
    ///
    /// # Errors
    /// [`Error::OffRod`]; `what` names the thing placed.
    pub fn place(&self, what: &'static str, s: f64) -> Result<Place, Error> {
        let length = self.length();
        let slack = 1e-9 * length;
        if !(s >= -slack && s <= length + slack) {
            return Err(Error::OffRod { what, s, length });
        }
        let mut start = 0.0;
        for (edge, l) in self.rest_lengths.iter().enumerate() {
            if s <= start + l || edge + 1 == self.segments() {
                return Ok(Place { edge, fraction: ((s - start) / l).clamp(0.0, 1.0) });
            }
            start += l;
        }
        unreachable!("a rod has at least one segment")
    }

    /// Bending is independent of θ: EI is a multiple of the identity everywhere and κ̄ = 0.
    pub(crate) fn is_isotropic_and_straight(&self) -> bool {
        self.ei.iter().all(|k| k[0] == k[2] && k[1] == 0.0)
            && self.natural_curvature.iter().all(|k| *k == [0.0; 2])
            && self.natural_twist.iter().all(|t| *t == 0.0)
    }

    /// Bending energy depends on the angles of sections.
    pub(crate) fn bends_by_angle(&self) -> bool {
        self.ei.iter().any(|k| k[0] != k[2] || k[1] != 0.0)
            || self.natural_curvature.iter().any(|k| *k != [0.0; 2])
    }

    /// Stiffness of a section at an interior vertex \[N m\], that against twist and the mean against bending.
    pub(crate) fn section_stiffness(&self, vertex: usize) -> f64 {
        let [k11, _, k22] = self.ei[vertex - 1];
        (self.gj[vertex - 1] + 0.5 * (k11 + k22)) / self.voronoi_lengths[vertex - 1]
    }

    /// Whether sections have inertia against spin.
    pub(crate) fn spins(&self) -> bool {
        !self.spin_inertia.is_empty()
    }

    /// A chain: no bending or twisting stiffness anywhere.
    pub(crate) fn is_chain(&self) -> bool {
        self.ei.iter().all(|k| *k == [0.0; 3]) && self.gj.iter().all(|g| *g == 0.0)
    }

    /// # Errors
    /// [`Error::Count`] or [`Error::Value`] naming the field.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.segments();
        if n == 0 {
            return Err(Error::Value { field: "segments", value: 0.0, expected: "at least 1" });
        }
        let count = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Count { field, found, expected }) }
        };
        count("voronoi_lengths", self.voronoi_lengths.len(), n - 1)?;
        count("ea", self.ea.len(), n)?;
        count("ei", self.ei.len(), n - 1)?;
        count("gj", self.gj.len(), n - 1)?;
        count("natural_curvature", self.natural_curvature.len(), n - 1)?;
        count("natural_twist", self.natural_twist.len(), n - 1)?;
        count("masses", self.masses.len(), n + 1)?;
        if self.spins() {
            count("spin_inertia", self.spin_inertia.len(), n)?;
        }
        self.spin_inertia.iter().try_for_each(|&v| positive("spin inertia", v))?;
        self.rest_lengths.iter().try_for_each(|&v| positive("rest length", v))?;
        self.voronoi_lengths.iter().try_for_each(|&v| positive("voronoi length", v))?;
        self.ea.iter().try_for_each(|&v| positive("EA", v))?;
        self.gj.iter().try_for_each(|&v| not_negative("GJ", v))?;
        self.masses.iter().try_for_each(|&v| positive("vertex mass", v))?;
        for k in &self.ei {
            not_negative("EI", k[0])?;
            not_negative("EI", k[2])?;
            not_negative("determinant of EI", k[0] * k[2] - k[1] * k[1])?;
        }
        let finite = |field, value: f64| {
            if value.is_finite() {
                Ok(())
            } else {
                Err(Error::Value { field, value, expected: "a finite number" })
            }
        };
        self.natural_twist.iter().try_for_each(|&v| finite("natural twist", v))?;
        self.natural_curvature.iter().flatten().try_for_each(|&v| finite("natural curvature", v))
    }
}

/// A place on the rod: an edge and how far along it (0 at its first vertex, 1 at its second).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Number of the edge.
    pub edge: usize,
    /// Position on it, between 0 and 1.
    pub fraction: f64,
}

//! What the numbers of a state mean: groups of vectors with names and units, and where they are in space.

use std::ops::Range;

/// The control of a model, which leads its state: x = [groups, one after the other; what follows from them].
///
/// A rod has the groups "position" and "velocity", three numbers to a vertex, and "angle" and "spin" of edges
/// where these are unknowns; other models have the one group
/// "state". Tables, tiles and figures loop over the groups.
#[derive(Debug, Clone, PartialEq)]
pub struct StateLayout {
    /// The groups, in the order of the control.
    pub groups: Vec<StateGroup>,
    /// A name for each number of the control.
    pub names: Vec<String>,
    /// Where the vectors of the groups are, for models in space.
    pub geometry: Option<Geometry>,
    /// Units of the constants that are estimated: the last names are theirs.
    pub constants: Vec<&'static str>,
}

/// Numbers of the control that mean the same thing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateGroup {
    /// Name in tables and in keys of summary.json: `position`, `velocity`, `angle`, `spin`, or
    /// [`WHOLE_STATE`].
    pub name: &'static str,
    /// SI unit; "1" for numbers without one.
    pub unit: &'static str,
    /// Its numbers in the control.
    pub range: Range<usize>,
    /// Numbers to a vector: 3 for positions in space, 1 for scalars.
    pub width: usize,
}

/// The name of the only group of a model whose numbers are all alike.
pub const WHOLE_STATE: &str = "state";

/// A curve in space on which the vectors of a state sit.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// Arc length of every vertex \[m\], prescribed vertices included.
    pub arc_lengths: Vec<f64>,
    /// The vertices that move freely: vector i of positions and velocities belongs to vertex `free[i]`.
    pub free: Vec<usize>,
    /// The edges whose angles and spins are in the control, by their first vertex; none where they follow.
    pub free_edges: Vec<usize>,
}

impl Geometry {
    /// Arc length of vector i of a group \[m\]: that of a vertex, or of the middle of an edge.
    pub fn place(&self, group: &StateGroup, i: usize) -> f64 {
        let s = &self.arc_lengths;
        match group.width {
            1 => 0.5 * (s[self.free_edges[i]] + s[self.free_edges[i] + 1]),
            _ => s[self.free[i]],
        }
    }
}

impl StateLayout {
    /// The layout of a model whose components are all alike.
    pub fn of_components(names: Vec<String>) -> Self {
        let group = StateGroup { name: WHOLE_STATE, unit: "1", range: 0..names.len(), width: 1 };
        StateLayout { groups: vec![group], names, geometry: None, constants: Vec::new() }
    }

    /// The layout [X, V] of a rod's free vertices, or [X, V, θ, ω] with its free edges.
    pub fn of_rod(geometry: Geometry) -> Self {
        let half = 3 * geometry.free.len();
        let names = |prefix: &'static str| {
            geometry.free.iter().flat_map(move |v| ["x", "y", "z"].map(|c| format!("{prefix}{c}[{v}]")))
        };
        let mut groups = vec![
            StateGroup { name: "position", unit: "m", range: 0..half, width: 3 },
            StateGroup { name: "velocity", unit: "m/s", range: half..2 * half, width: 3 },
        ];
        let mut names: Vec<String> = names("").chain(names("v")).collect();
        let kinds = [("angle", "rad"), ("spin", "rad/s")];
        for (name, unit) in kinds.into_iter().filter(|_| !geometry.free_edges.is_empty()) {
            let first = names.len();
            names.extend(geometry.free_edges.iter().map(|e| format!("{name}[{e}]")));
            groups.push(StateGroup { name, unit, range: first..names.len(), width: 1 });
        }
        StateLayout { groups, names, geometry: Some(geometry), constants: Vec::new() }
    }

    /// The same with constants behind the state, by name and unit.
    pub fn with_constants(mut self, constants: impl IntoIterator<Item = (String, &'static str)>) -> Self {
        for (name, unit) in constants {
            self.names.push(name);
            self.constants.push(unit);
        }
        self
    }

    /// Length of the control.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether the control has no numbers.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Name and unit of every number of the control.
    pub fn components(&self) -> impl Iterator<Item = (&str, &'static str)> {
        let units = self.groups.iter().flat_map(|g| g.range.clone().map(|_| g.unit));
        self.names.iter().map(String::as_str).zip(units.chain(self.constants.iter().copied()))
    }

    /// For each group the root of the mean squared length of the vectors of a − b.
    ///
    /// # Panics
    /// If `a` or `b` is shorter than the control.
    pub fn rms_difference(&self, a: &[f64], b: &[f64]) -> Vec<f64> {
        let of = |g: &StateGroup| {
            let pairs = a[g.range.clone()].iter().zip(&b[g.range.clone()]);
            let sum: f64 = pairs.map(|(a, b)| (a - b) * (a - b)).sum();
            (sum * g.width as f64 / g.range.len().max(1) as f64).sqrt()
        };
        self.groups.iter().map(of).collect()
    }
}

impl StateGroup {
    /// Its name where it is one of several groups: `None` for the whole state.
    pub fn part(&self) -> Option<&'static str> {
        (self.name != WHOLE_STATE).then_some(self.name)
    }

    /// A quantity of this group in words: "RMSE position", or "RMSE" alone for the whole state.
    pub fn labelled(&self, quantity: &str) -> String {
        match self.part() {
            Some(name) => format!("{quantity} {name}"),
            None => quantity.to_string(),
        }
    }

    /// Its unit as it follows a number: " m", or nothing for numbers without a unit.
    pub fn unit_after(&self) -> String {
        if self.unit == "1" { String::new() } else { format!(" {}", self.unit) }
    }

    /// Its unit in a heading: `" [m]"`, or nothing for numbers without a unit.
    pub fn unit_in_heading(&self) -> String {
        if self.unit == "1" { String::new() } else { format!(" [{}]", self.unit) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rms_is_that_of_vectors_in_each_group() {
        let geometry =
            Geometry { arc_lengths: vec![0.0, 0.5, 1.0], free: vec![1, 2], free_edges: Vec::new() };
        let rod = StateLayout::of_rod(geometry.clone());
        let mut a = vec![0.0; 12];
        (a[0], a[4], a[6]) = (3.0, 4.0, 2.0);
        // Two vertices off by 3 and 4: √(25/2). One velocity of two off by 2: √(4/2).
        assert_eq!(rod.rms_difference(&a, &[0.0; 12]), [12.5_f64.sqrt(), 2.0_f64.sqrt()]);
        assert_eq!(rod.components().nth(7), Some(("vy[1]", "m/s")));
        let spinning = StateLayout::of_rod(Geometry { free_edges: vec![1], ..geometry });
        assert_eq!(spinning.components().nth(13), Some(("spin[1]", "rad/s")));
        assert_eq!(spinning.geometry.as_ref().unwrap().place(&spinning.groups[2], 0), 0.75);
        let three = StateLayout::of_components(["x", "y", "z"].map(String::from).to_vec());
        assert_eq!(three.rms_difference(&[1.0, 2.0, 2.0], &[0.0; 3]), [3.0_f64.sqrt()]);
        assert_eq!(three.groups[0].labelled("RMSE"), "RMSE");
    }
}

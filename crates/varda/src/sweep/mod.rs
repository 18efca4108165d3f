//! A study: a scene with several values of its keys and several seeds, each run a process of its own.
//!
//! [`grid`] says which runs there are, [`runs`] starts them and keeps what each gave, [`table`] makes rows
//! and means of that. A study is a folder: sweep.json is its plan, `runs/<index>.json` a run that has ended.
//! A study that was ended goes on where it was, since what is there is not run again.

pub mod grid;
pub mod runs;
pub mod table;

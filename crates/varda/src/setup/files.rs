//! The data files of a scene, each read once.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::Error;
use crate::scene::SceneFile;

/// Reads the files that a scene names, and remembers what was read.
pub(crate) struct Files<'a> {
    pub(crate) scene: &'a SceneFile,
    texts: RefCell<BTreeMap<String, Rc<str>>>,
    read: RefCell<Vec<InputFile>>,
}

/// A data file that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputFile {
    /// The key of the scene that names it.
    pub key: String,
    /// Its path.
    pub path: String,
    /// FNV-1a of its contents.
    pub checksum: u64,
}

impl<'a> Files<'a> {
    pub(crate) fn of(scene: &'a SceneFile) -> Self {
        Files { scene, texts: RefCell::default(), read: RefCell::default() }
    }

    /// The name for messages and the text of the file that a key names. A file that two keys name is read for
    /// the first of them.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Scene`] where a shipped scene names a file that is not shipped.
    pub(crate) fn text(&self, key: &str, name: &str) -> Result<(String, Rc<str>), Error> {
        let source = self.scene.source(key, name)?;
        let label = source.label();
        let known = self.texts.borrow().get(&label).cloned();
        let text = match known {
            Some(text) => text,
            None => Rc::from(source.read()?),
        };
        self.texts.borrow_mut().insert(label.clone(), Rc::clone(&text));
        let checksum = checksum(&text);
        let mut read = self.read.borrow_mut();
        if !read.iter().any(|file| file.key == key) {
            read.push(InputFile { key: key.to_string(), path: label.clone(), checksum });
        }
        Ok((label, text))
    }

    /// The files that were read, in the order of reading.
    pub(crate) fn into_read(self) -> Vec<InputFile> {
        self.read.into_inner()
    }
}

/// FNV-1a of a text (64 bit).
pub(crate) fn checksum(text: &str) -> u64 {
    let step = |sum: u64, byte: u8| (sum ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    text.bytes().fold(0xcbf2_9ce4_8422_2325, step)
}

//! Recordings of motion-capture systems: every kind read right, every fault named. The files are written
//! here, by the public descriptions of their formats.

use varda::convert::{Options, Recording, Unit, Up, read};

const PLAIN: Options = Options { up: None, unit: None };

fn right(file: &str, bytes: &[u8], options: &Options) -> Recording {
    read(file, bytes, options).unwrap_or_else(|e| panic!("{file}: {e}"))
}

fn refused(file: &str, bytes: &[u8], parts: &[&str]) {
    let message = read(file, bytes, &PLAIN).map(|r| r.to_csv()).unwrap_err().to_string();
    assert!(message.starts_with(file), "{message}");
    parts.iter().for_each(|part| assert!(message.contains(part), "{file}: {part:?} is not in {message}"));
}

fn trc() -> String {
    "PathFileType\t4\t(X/Y/Z)\tcable.trc\r\n\
     DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\r\n\
     100.0\t100.0\t3\t2\tmm\t100.0\t1\t3\r\n\
     Frame#\tTime\tbase\t\t\ttip\t\t\t\r\n\
     \t\tX1\tY1\tZ1\tX2\tY2\tZ2\r\n\
     \r\n\
     1\t0.00\t0.5\t1000\t0\t100\t500\t-20\r\n\
     2\t0.01\t0.5\t1000\t0\t\t\t\r\n\
     3\t0.02\t0.5\t1000\t0.1\t102\t502\t-22\r\n"
        .to_string()
}

#[test]
fn a_trc_file_is_read_with_its_gaps_units_and_axes() {
    let plain = right("cable.trc", trc().as_bytes(), &PLAIN);
    assert_eq!(
        plain.to_csv(),
        "time_s,marker,x_m,y_m,z_m\n0,base,0.0005,1,0\n0,tip,0.1,0.5,-0.02\n0.01,base,0.0005,1,0\n\
         0.02,base,0.0005,1,0.0001\n0.02,tip,0.102,0.502,-0.022\n"
    );
    assert_eq!((plain.kind, plain.tracks[1].gaps()), ("TRC", (1, 1)));
    assert!(plain.remarks[0].contains("--up y"), "{:?}", plain.remarks);
    let turned = right("cable.trc", trc().as_bytes(), &Options { up: Some(Up::Y), unit: None });
    assert_eq!(turned.tracks[1].rows[0].2, [0.1, 0.02, 0.5]);
    let metres = right("cable.trc", trc().as_bytes(), &Options { up: None, unit: Some(Unit::Metre) });
    assert_eq!(metres.tracks[0].rows[0].2, [0.5, 1000.0, 0.0]);
    let other = trc().replace("\t2\tmm", "\t2\tinch");
    refused("inch.trc", other.as_bytes(), &["inch.trc:3", "inch", "--unit"]);
}

#[test]
fn faults_of_a_trc_file_are_named_with_their_line() {
    let with = |old: &str, new: &str| {
        assert!(trc().contains(old), "{old:?}");
        trc().replace(old, new)
    };
    for (text, parts) in [
        (with("2\t0.01", "2\t0.00"), vec![":8:", "Time = 0 is not after"]),
        (with("\t100\t500", "\tfive\t500"), vec![":7:", "x of marker tip = \"five\""]),
        (with("\t102\t502", "\t102\t"), vec![":9:", "marker tip has not all of its three"]),
        (with("base\t\t\ttip", "base\ttip"), vec![":4:", "three columns after"]),
        (with("\t3\t2\tmm", "\t3\t5\tmm"), vec![":4:", "NumMarkers = 5", "names 2"]),
        (with("-20\r\n", "-20\t7\r\n"), vec![":7:", "more than 8 columns"]),
        (with("2\t0.01", "2\t"), vec![":8:", "without a time"]),
        (with("Frame#", "Row"), vec![":4:", "`Frame#`"]),
        (trc().lines().take(3).collect::<Vec<_>>().join("\n"), vec![":4:", "the file ends where names"]),
        (trc().lines().take(6).collect::<Vec<_>>().join("\n"), vec!["no marker was seen"]),
        (with("mm", ""), vec!["does not say the unit", "--unit"]),
    ] {
        refused("bad.trc", text.as_bytes(), &parts);
    }
    let short = trc().replace("\t3\t2\tmm", "\t9\t2\tmm");
    let remarks = right("short.trc", short.as_bytes(), &PLAIN).remarks;
    assert!(remarks.iter().any(|r| r.contains("NumFrames = 9, and the file has 3")), "{remarks:?}");
}

const MOTIVE: &str = "\u{feff}Format Version,1.23,Take Name,swing,Capture Frame Rate,120.000000,\
    Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global\n\
    \n\
    ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker,\
    Marker,Marker,Marker\n\
    ,Name,hand,hand,hand,hand,hand,hand,hand,rod:tip,rod:tip,rod:tip,rod:mid,rod:mid,rod:mid\n\
    ,ID,1,1,1,1,1,1,1,2,2,2,3,3,3\n\
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position,Position,\
    Position,Position\n\
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z,X,Y,Z\n\
    0,0.000000,0,0,0,1,5,6,7,100,500,20,10,800,1\n\
    1,0.008333,0,0,0,1,5,6,7,,,,11,801,2\n\
    2,0.016667,0,0,0,1,5,6,7,0,0,0,12,802,3\n";

#[test]
fn a_csv_of_motive_is_read_with_blank_cells_as_gaps() {
    let recording = right("take.csv", MOTIVE.as_bytes(), &Options { up: Some(Up::Y), unit: None });
    assert_eq!(recording.kind, "Motive CSV");
    assert_eq!(
        recording.to_csv(),
        "time_s,marker,x_m,y_m,z_m\n0,rod:tip,0.1,-0.02,0.5\n0,rod:mid,0.01,-0.001,0.8\n\
         0.008333,rod:mid,0.011,-0.002,0.801\n0.016667,rod:mid,0.012,-0.003,0.802\n"
    );
    let told = |part: &str| recording.remarks.iter().any(|r| r.contains(part));
    assert!(told("1 places of exactly 0,0,0") && told("(x, −z, y)"), "{:?}", recording.remarks);
    let bodies =
        MOTIVE.replace(",Marker,Marker,Marker", ",Rigid Body Marker,Rigid Body Marker,Rigid Body Marker");
    let bodies =
        bodies.replace("Marker,Marker,Marker\n", "Rigid Body Marker,Rigid Body Marker,Rigid Body Marker\n");
    let recording = right("bodies.csv", bodies.as_bytes(), &PLAIN);
    assert!(recording.remarks.iter().any(|r| r.contains("computes from the body's pose")));
}

#[test]
fn faults_of_a_csv_of_motive_are_named() {
    for (old, new, parts) in [
        ("Millimeters", "Furlongs", vec![":1:", "Length Units"]),
        ("Length Units,Millimeters,", "", vec!["does not say the unit"]),
        ("Global", "Local", vec![":1:", "global space"]),
        ("Frame,Time", "Row,Time", vec![":2:", "no line `Frame"]),
        ("1,0.008333", "1,-0.1", vec![":9:", "is not after the row before"]),
        ("100,500,20", "100,,20", vec![":8:", "not all of its three"]),
        ("12,802,3", "12,802,3,9", vec![":10:", "more than 15 columns"]),
        ("12,802,3", "12,inf,3", vec![":10:", "y of marker rod:mid"]),
        ("Marker,Marker,Marker", "Thing,Thing,Thing", vec!["no markers"]),
    ] {
        assert!(MOTIVE.contains(old));
        let text = MOTIVE.replace(old, new).replace(
            "Marker,Marker,Marker\n",
            if old.starts_with("Marker") { "Thing,Thing,Thing\n" } else { "Marker,Marker,Marker\n" },
        );
        refused("take.csv", text.as_bytes(), &parts);
    }
}

const VICON: &str = "Devices\n1000\n,Force\nFrame,Sub Frame,Fx\n,,N\n1,0,5\n\n\
    Trajectories\n200\n,,cable:m1,,,cable:m2,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n\
    101,0,1,2,3,10,20,30\n102,0,1.5,2,3,,,\n104,0,2,2,3,11,21,31\n";

#[test]
fn a_csv_of_nexus_is_read_from_its_section() {
    let recording = right("trial.csv", VICON.as_bytes(), &Options { up: Some(Up::Z), unit: None });
    assert_eq!(recording.kind, "Vicon CSV");
    assert_eq!(
        recording.to_csv(),
        "time_s,marker,x_m,y_m,z_m\n0.5,cable:m1,0.001,0.002,0.003\n0.5,cable:m2,0.01,0.02,0.03\n\
         0.505,cable:m1,0.0015,0.002,0.003\n0.515,cable:m1,0.002,0.002,0.003\n\
         0.515,cable:m2,0.011,0.021,0.031\n"
    );
    assert_eq!(recording.tracks.iter().map(|t| t.gaps()).collect::<Vec<_>>(), [(1, 1), (1, 2)]);
    assert!(recording.remarks.is_empty(), "{:?}", recording.remarks);
    for (old, new, parts) in [
        ("\n200\n", "\n\n", vec![":9:", "rate"]),
        ("102,0", "101,0", vec![":14:", "Frame = 101 is not after"]),
        ("104,0", "0x68,0", vec![":15:", "is not a number of a frame"]),
        ("11,21,31", "11,21", vec![":15:", "cable:m2 has not all"]),
        ("mm,mm,mm,mm,mm,mm", "mm,mm,mm,m,m,m", vec![":12:", "different units"]),
        ("mm,mm,mm,mm,mm,mm", "ft,ft,ft,ft,ft,ft", vec![":12:", "ft", "--unit"]),
        ("Frame,Sub Frame,X", "Row,Sub Frame,X", vec![":11:", "Frame,Sub Frame"]),
    ] {
        assert!(VICON.contains(old));
        refused("trial.csv", VICON.replace(old, new).as_bytes(), &parts);
    }
}

/// A C3D file of two markers and an analogue channel: frames 11 to 13 at 50 Hz, the second marker lost in
/// frame 12.
struct C3d {
    is_real: bool,
    unit: &'static str,
    y_screen: &'static str,
    processor: u8,
}

const GOOD: C3d = C3d { is_real: true, unit: "mm", y_screen: "+Y", processor: 84 };
const SEEN: [[[f64; 3]; 2]; 3] = [
    [[100.0, 500.0, -20.0], [10.0, 20.0, 30.0]],
    [[101.0, 501.0, -21.0], [0.0, 0.0, 0.0]],
    [[102.0, 502.0, -22.0], [12.0, 22.0, 32.0]],
];

impl C3d {
    fn group(id: i8, name: &str) -> Vec<u8> {
        let mut all = vec![name.len() as u8, (-id) as u8];
        all.extend(name.as_bytes());
        all.extend(3_u16.to_le_bytes());
        all.push(0);
        all
    }

    fn parameter(id: i8, name: &str, size: i8, dimensions: &[u8], values: &[u8]) -> Vec<u8> {
        let mut all = vec![name.len() as u8, id as u8];
        all.extend(name.as_bytes());
        all.extend(((5 + dimensions.len() + values.len()) as u16).to_le_bytes());
        all.extend([size as u8, dimensions.len() as u8]);
        all.extend(dimensions);
        all.extend(values);
        all.push(0);
        all
    }

    fn bytes(&self) -> Vec<u8> {
        let scale: f32 = if self.is_real { -0.5 } else { 0.5 };
        let mut all = vec![0_u8; 512];
        all[..2].copy_from_slice(&[2, 0x50]);
        for (at, word) in [(2, 2_u16), (4, 1), (6, 11), (8, 13), (16, 4), (18, 1)] {
            all[at..at + 2].copy_from_slice(&word.to_le_bytes());
        }
        all[12..16].copy_from_slice(&scale.to_le_bytes());
        all[20..24].copy_from_slice(&50_f32.to_le_bytes());
        let mut parameters = vec![1, 0x50, 2, self.processor];
        parameters.extend(C3d::group(1, "POINT"));
        parameters.extend(C3d::parameter(1, "USED", 2, &[], &2_u16.to_le_bytes()));
        parameters.extend(C3d::parameter(1, "SCALE", 4, &[], &scale.to_le_bytes()));
        parameters.extend(C3d::parameter(1, "RATE", 4, &[], &50_f32.to_le_bytes()));
        parameters.extend(C3d::parameter(1, "LABELS", -1, &[4, 2], b"tip mid "));
        if !self.unit.is_empty() {
            let length = self.unit.len() as u8;
            parameters.extend(C3d::parameter(1, "UNITS", -1, &[length], self.unit.as_bytes()));
        }
        if !self.y_screen.is_empty() {
            parameters.extend(C3d::parameter(1, "Y_SCREEN", -1, &[2], self.y_screen.as_bytes()));
        }
        parameters.push(0);
        parameters.resize(1024, 0);
        all.extend(parameters);
        for frame in SEEN {
            for place in frame {
                let residual = if place == [0.0; 3] { -1.0 } else { 0.0 };
                for value in place.into_iter().chain([residual]) {
                    if self.is_real {
                        all.extend((value as f32).to_le_bytes());
                    } else if value == residual {
                        all.extend((value as i16).to_le_bytes());
                    } else {
                        all.extend(((value / f64::from(scale)) as i16).to_le_bytes());
                    }
                }
            }
            let analogue =
                if self.is_real { 7_f32.to_le_bytes().to_vec() } else { 7_u16.to_le_bytes().to_vec() };
            all.extend(analogue);
        }
        all
    }
}

#[test]
fn a_c3d_file_is_read_in_both_formats_of_numbers() {
    for is_real in [true, false] {
        let recording = right("trial.c3d", &C3d { is_real, ..GOOD }.bytes(), &PLAIN);
        assert_eq!(
            recording.to_csv(),
            "time_s,marker,x_m,y_m,z_m\n0.2,tip,0.1,0.02,0.5\n0.2,mid,0.01,-0.03,0.02\n\
             0.22,tip,0.101,0.021,0.501\n0.24,tip,0.102,0.022,0.502\n0.24,mid,0.012,-0.032,0.022\n",
            "{is_real}"
        );
        assert_eq!(recording.tracks[1].gaps(), (1, 1));
    }
    let kept = right("up.c3d", &C3d { y_screen: "+Z", ..GOOD }.bytes(), &PLAIN);
    assert_eq!(kept.tracks[0].rows[0].2, [0.1, 0.5, -0.02]);
    assert!(kept.remarks.is_empty(), "{:?}", kept.remarks);
    let unsaid = right("unsaid.c3d", &C3d { y_screen: "", unit: "m", ..GOOD }.bytes(), &PLAIN);
    assert_eq!(unsaid.tracks[0].rows[0].2, [100.0, 500.0, -20.0]);
    assert!(unsaid.remarks[0].contains("which axis points upwards"));
}

#[test]
fn faults_of_a_c3d_file_are_named() {
    refused("unit.c3d", &C3d { unit: "", ..GOOD }.bytes(), &["does not say the unit"]);
    refused("inch.c3d", &C3d { unit: "inch", ..GOOD }.bytes(), &["POINT:UNITS = \"inch\""]);
    refused("dec.c3d", &C3d { processor: 85, ..GOOD }.bytes(), &["DEC"]);
    refused("mips.c3d", &C3d { processor: 86, ..GOOD }.bytes(), &["MIPS"]);
    refused("none.c3d", &C3d { processor: 1, ..GOOD }.bytes(), &["processor 1"]);
    let good = GOOD.bytes();
    refused("short.c3d", &good[..good.len() - 50], &["frames 11 to 13", "ends after 1 of these 3"]);
    refused("header.c3d", &good[..560], &["it ends at byte 560"]);
    let with = |at: usize, word: u16| {
        let mut bytes = good.clone();
        bytes[at..at + 2].copy_from_slice(&word.to_le_bytes());
        bytes
    };
    refused("frames.c3d", &with(8, 5), &["frames are 11 to 5"]);
    // Whatever is in a file: no panic.
    for at in 0..good.len() {
        let mut bytes = good.clone();
        bytes[at] ^= 0xff;
        let _ = read("flipped.c3d", &bytes, &PLAIN);
        let _ = read("cut.c3d", &good[..at], &PLAIN);
    }
}

#[test]
fn what_is_no_recording_is_told_what_is() {
    refused("empty.csv", b"", &["the file is empty"]);
    refused("wide.csv", &[0xff, 0xfe, b't', 0], &["UTF-16", "UTF-8"]);
    refused("own.csv", b"time_s,marker,x_m,y_m,z_m\n", &["neither a C3D", "needs no conversion"]);
    refused("photo.csv", b"\n\n\xb5\xb5\xb5", &["photo.csv:3", "UTF-8"]);
}

#[test]
fn names_that_a_table_could_not_hold_are_quoted_and_told_apart() {
    let text = trc().replace("base", "tip");
    let recording = right("twice.trc", text.as_bytes(), &PLAIN);
    assert_eq!(recording.tracks[1].name, "tip-2");
    assert!(recording.remarks.iter().any(|r| r.contains("is named \"tip-2\"")));
    let text = trc().replace("base", "a,b");
    assert!(right("comma.trc", text.as_bytes(), &PLAIN).to_csv().contains("0,\"a,b\",0.0005"));
    let rows = varda::setup::csv::observations("c", &right("c", text.as_bytes(), &PLAIN).to_csv()).unwrap();
    assert_eq!(rows[0].subject, varda::setup::csv::Subject::Marker("a,b".into()));
}

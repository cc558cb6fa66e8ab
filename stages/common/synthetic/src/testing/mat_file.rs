//! Small MATLAB 5 files, which the program reads and does not write.

/// The 128 bytes before the first element, little endian.
pub fn header() -> Vec<u8> {
    let mut bytes = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".to_vec();
    bytes.resize(124, b' ');
    bytes.extend([0, 1, b'I', b'M']);
    bytes
}

/// A tagged element of a type, padded to eight bytes.
pub fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = kind.to_le_bytes().to_vec();
    bytes.extend((data.len() as u32).to_le_bytes());
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

/// An array of doubles, by columns.
pub fn array(name: &str, dims: &[i32], values: &[f64]) -> Vec<u8> {
    // Types of elements.
    let [int8, int32, uint32, double, matrix] = [1, 5, 6, 9, 14];
    let dims: Vec<u8> = dims.iter().flat_map(|d| d.to_le_bytes()).collect();
    let values: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let parts = [
        element(uint32, &[6, 0, 0, 0, 0, 0, 0, 0]),
        element(int32, &dims),
        element(int8, name.as_bytes()),
        element(double, &values),
    ];
    element(matrix, &parts.concat())
}

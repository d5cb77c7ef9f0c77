// The body of a query, of a basis as JSON and a scan in KITTI's format:
// make_signature BASIS.json SCAN.bin [SENSOR_HEIGHT_M] > BODY
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>

#include "tensormap/tensormap.hpp"

namespace {

std::string read_file(const char* path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error(std::string(path) + " cannot be read");
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// Records have no beginning of their own, and archives may be a whole number of them.
std::string container_of(const std::string& bytes) {
    const auto begins = [&](std::size_t at, const std::string& magic) {
        return bytes.size() >= at + magic.size() && bytes.compare(at, magic.size(), magic) == 0;
    };
    if (begins(0, "PK\x03\x04")) return "zip";
    // The fourth byte of a coordinate that begins so is not one of gzip's flags.
    if (begins(0, "\x1f\x8b\x08") && bytes.size() > 3 && (bytes[3] & 0xe0) == 0) return "gzip";
    if (begins(0, "\x89HDF\r\n\x1a\n")) return "HDF5";
    return begins(257, "ustar") ? "tar" : "";
}

double height_of(const std::string& word) {
    std::size_t read = 0;
    try {
        const double height_m = std::stod(word, &read);
        if (read == word.size()) return height_m;
    } catch (const std::exception&) {
    }
    throw std::runtime_error("SENSOR_HEIGHT_M is '" + word + "', wanted a number");
}

}  // namespace

int main(int count, char** words) try {
    if (count < 3 || count > 4) {
        std::cerr << "usage: make_signature BASIS.json SCAN.bin [SENSOR_HEIGHT_M]\n";
        return 2;
    }
    const std::string json = read_file(words[1]), scan = read_file(words[2]);
    const auto basis = tensormap::Basis::of(tensormap::JsonReader(json).read());
    const double height_m = count == 4 ? height_of(words[3]) : basis.sensor_height_m;
    const auto kind = container_of(scan);
    if (!kind.empty()) {
        throw std::runtime_error(std::string(words[2]) + " is a file of kind " + kind +
                                 ", wanted records of 16 bytes");
    }
    if (scan.size() % 16 != 0) {
        throw std::runtime_error(std::string(words[2]) + " has " + std::to_string(scan.size()) +
                                 " bytes, wanted 16 a return");
    }
    std::vector<float> rows(scan.size() / sizeof(float));  // of a little-endian machine
    if (!rows.empty()) std::memcpy(rows.data(), scan.data(), scan.size());
    const auto body = tensormap::query(rows.data(), rows.size() / 4, 4, basis, height_m);
    std::cout.write(reinterpret_cast<const char*>(body.data()),
                    static_cast<std::streamsize>(body.size()));
    return 0;
} catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
}

// Stop and go, as a program: straight to the desired TCP, and a stop while a hand is nearer than 300 mm.
// It speaks the protocol of docs/reference/controller-protocol.md, a JSON object a line, by standard input and output:
//
//     c++ -O2 -std=c++17 -o stop_and_go stop_and_go.cpp
//     safety-harness run shipped:hand-visits-and-leaves --controller "exec:./stop_and_go"
//
// A program of yours will have a JSON library; this one finds the few numbers that it needs by their names.
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>

using Vector = std::array<double, 3>;

// Where the value of a name begins, at or after `from`; npos if there is none.
static size_t value_of(const std::string& text, const std::string& name, size_t from = 0) {
    const auto key = "\"" + name + "\":";
    const auto at = text.find(key, from);
    return at == std::string::npos ? at : at + key.size();
}

// Three numbers in brackets at `at`.
static Vector vector_at(const std::string& text, size_t at) {
    Vector found{};
    const char* here = text.c_str() + at + 1;
    for (auto& number : found) {
        char* end = nullptr;
        number = std::strtod(here, &end);
        if (end == here) std::exit(2);  // null: not known
        here = end + 1;
    }
    return found;
}

static double distance_m(const Vector& a, const Vector& b) {
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

int main() {
    Vector target_in_base_m{};
    std::string line;
    while (std::getline(std::cin, line)) {
        const auto said = line.substr(value_of(line, "say") + 1, 3);
        if (said == "hel") {
            std::puts(R"({"say":"hello","protocol":"safety-harness controller 1",)"
                      R"("name":"stop and go in C++","sees":["joints","hands"]})");
        } else if (said == "res") {
            target_in_base_m = vector_at(line, value_of(line, "desired_tcp_position_in_base_m"));
            std::puts(R"({"say":"ready"})");
        } else if (said == "act") {
            const auto tick = std::atoi(line.c_str() + value_of(line, "tick"));
            const auto tcp_in_base_m = vector_at(line, value_of(line, "tcp_position_in_base_m"));
            bool near = false;
            for (auto at = value_of(line, "hands"); at != std::string::npos;) {
                at = value_of(line, "position_in_base_m", at);
                if (at != std::string::npos) near |= distance_m(vector_at(line, at), tcp_in_base_m) < 0.3;
            }
            if (near) {
                std::printf("{\"say\":\"stop\",\"tick\":%d}\n", tick);
            } else {
                std::printf("{\"say\":\"move\",\"tick\":%d,\"tcp_velocity_mps\":[%.17g,%.17g,%.17g]}\n", tick,
                            0.5 * (target_in_base_m[0] - tcp_in_base_m[0]),
                            0.5 * (target_in_base_m[1] - tcp_in_base_m[1]),
                            0.5 * (target_in_base_m[2] - tcp_in_base_m[2]));
            }
        } else {
            return 2;
        }
        std::fflush(stdout);  // or the harness waits for what lies in a buffer
    }
}

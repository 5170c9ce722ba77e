/*
Loads a model that `safety-harness export --format torchscript` wrote and prints one prediction:
position, then spread, in metres in the robot's base frame.

    predict mc-dropout.pt 0.84 -0.35 0.10  0.70 0.00 0.35  7
                          hand [m]         TCP [m]         seed

Built against libtorch, which PyTorch's Python package contains:

    T=$(python -c 'import torch; print(torch.__path__[0])')
    g++ -std=c++20 predict.cpp -o predict -isystem $T/include -isystem $T/include/torch/csrc/api/include \
        -L$T/lib -ltorch -ltorch_cpu -lc10 -Wl,-rpath,$T/lib
*/

#include <torch/script.h>

#include <cstdint>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

// The finalizer of splitmix64 (Steele, Lea, Flood 2014).
static std::uint64_t mixed(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

// Which units stay, a pure function of seed, pass, place and unit: the same as the Python package draws.
static torch::Tensor masks(std::uint64_t seed, long passes, long places, long width, double probability) {
  const std::uint64_t gamma = 0x9E3779B97F4A7C15u;
  const std::uint64_t key = mixed(seed + gamma);
  const auto drop_below = static_cast<std::uint64_t>(probability * 18446744073709551616.0);  // 2^64
  auto kept = torch::empty({1, passes, places, width}, torch::kBool);
  bool* at = kept.data_ptr<bool>();
  for (std::uint64_t pass = 0; pass < static_cast<std::uint64_t>(passes); ++pass)
    for (std::uint64_t place = 0; place < static_cast<std::uint64_t>(places); ++place)
      for (std::uint64_t unit = 0; unit < static_cast<std::uint64_t>(width); ++unit)
        *at++ = mixed(key + ((pass << 32) | (place << 16) | unit) * gamma) >= drop_below;
  return kept;
}

static torch::Tensor point(char** text) {
  return torch::tensor({{std::stod(text[0]), std::stod(text[1]), std::stod(text[2])}}, torch::kFloat64);
}

static void print(const char* name, const torch::Tensor& rows) {
  const auto row = rows[0];
  std::printf("%s %.17g %.17g %.17g\n", name, row[0].item<double>(), row[1].item<double>(),
              row[2].item<double>());
}

int main(int count, char** arguments) {
  if (count != 8 && count != 9) {
    std::fprintf(stderr, "usage: predict MODEL.pt  HAND_X HAND_Y HAND_Z  TCP_X TCP_Y TCP_Z  [SEED]\n");
    return 2;
  }
  try {
    torch::NoGradGuard no_gradients;
    torch::jit::ExtraFilesMap about{{"passes", ""}, {"places", ""}, {"width", ""}, {"dropout_probability", ""}};
    auto model = torch::jit::load(arguments[1], torch::kCPU, about);
    std::vector<torch::jit::IValue> inputs{point(arguments + 2), point(arguments + 5)};
    const long places = std::stol(about["places"]);
    if (places > 0) {
      const std::uint64_t seed = count == 9 ? std::stoull(arguments[8]) : 0;
      inputs.emplace_back(masks(seed, std::stol(about["passes"]), places, std::stol(about["width"]),
                                std::stod(about["dropout_probability"])));
    }
    const auto answer = model.forward(inputs).toTuple();
    print("position_in_base_m", answer->elements()[0].toTensor());
    print("spread_m", answer->elements()[1].toTensor());
  } catch (const c10::Error& error) {
    std::fprintf(stderr, "predict: %s\n", error.what_without_backtrace());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "predict: %s\n", error.what());
    return 2;
  }
}

// Answer from a table in C++17: lookup TABLE.wbt, then its loads, such as Fx Fy Fz Mx My Mz.
// Link it with the library of `wrenchbook export plate_thin plate.zip`; -I names its include folder.
#include "wrenchbook.h"

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace wrenchbook {

struct Answer {
    int coverage;  // WB_COVERED, WB_THIN or WB_OUTSIDE
    std::vector<double> outputs, error;  // m and rad; error bars, NaN where unknown
};

// A mapped table. It owns its scratch: use one Table in each thread.
class Table {
public:
    explicit Table(const std::string &path) {
        char why[256] = "";
        table_.reset(wb_open(path.c_str(), why, sizeof why));
        if (!table_) throw std::runtime_error(path + ": " + why);
        scratch_.resize(wb_scratch(table_.get()) / sizeof(double) + 1);
    }

    std::size_t inputs() const { return static_cast<std::size_t>(wb_inputs(table_.get())); }

    Answer answer(const std::vector<double> &loads) {
        if (loads.size() != inputs())
            throw std::invalid_argument("the table has " + std::to_string(inputs()) + " loads");
        wb_reply reply;
        if (int code = wb_answer(table_.get(), nullptr, loads.data(), &reply, scratch_.data()))
            throw std::runtime_error("wb_answer returns " + std::to_string(code));
        const int count = wb_outputs(table_.get());
        return {reply.coverage, {reply.outputs, reply.outputs + count},
                {reply.error, reply.error + count}};
    }

private:
    struct Close {
        void operator()(wb_table *table) const { wb_close(table); }
    };
    std::unique_ptr<wb_table, Close> table_;
    std::vector<double> scratch_;  // doubles: aligned to 8 bytes
};

}  // namespace wrenchbook

int main(int count, char **words) try {
    if (count < 2) throw std::invalid_argument("give a table and its loads");
    wrenchbook::Table table(words[1]);
    std::vector<double> loads;
    for (int k = 2; k < count; k++) {
        char *end = words[k];
        loads.push_back(std::strtod(words[k], &end));
        if (*end || end == words[k])
            throw std::invalid_argument("'" + std::string(words[k]) + "' is not a number");
    }
    const wrenchbook::Answer answer = table.answer(loads);
    const char *coverage[] = {"covered", "thin", "outside"};
    std::printf("%s\n", coverage[answer.coverage]);
    for (std::size_t k = 0; k < answer.outputs.size(); k++)
        std::printf("%.17g +- %.17g\n", answer.outputs[k], answer.error[k]);
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}

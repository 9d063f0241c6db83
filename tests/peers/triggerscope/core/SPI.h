// The bus to the DAC chip: what passes between two edges of its select pin is one logged frame.
#pragma once
#include "Arduino.h"

struct SPISettings {
    SPISettings(uint32_t, int, int) {}
};

class SPIClass {
  public:
    void begin() { begun = true; }
    void beginTransaction(SPISettings) {}
    uint8_t transfer(uint8_t value);
    bool begun = false;
    std::string frame;
};
extern SPIClass SPI;
